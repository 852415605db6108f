// JSON and NPZ files that users hand to the programs.
#pragma once

#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "output/npz.h"
#include "programs/json_output.h"
#include "programs/scene_drawing.h"
#include "saltus/audit/external_gradient.h"
#include "saltus/scene/scene.h"

namespace saltus {

// The document in `text`. What is none is an InputError that begins with `where` and names the line and column, and
// `expected`, such as "a JSON object".
Json ParseJson(const std::string& text, const std::string& where, const std::string& expected);

// The base of readers of such files; their errors name the place in the file.
class InputReader {
 public:
  // Errors begin with `where`.
  explicit InputReader(std::string where) : where_(std::move(where)) {}

  const std::string& where() const { return where_; }

  // Throws InputError: the value under `key` is not the expected one.
  [[noreturn]] void Fail(const std::string& key, const std::string& expected) const;

  // Reads a file; errors of reading it begin with `before`. An NPZ file becomes the document of a run: arrays are
  // nested lists, those that saltus_solve writes have the keys of its JSON, and the text of the scene is "scene_file".
  // Touches name discs and walls by their numbers.
  Json ReadDocument(const std::string& path, const std::string& before = "") const;

 private:
  Json DocumentOf(const NpzArrays& arrays) const;

  std::string where_;
};

// A control or a solution from a file, of saltus or of another solver.
struct SavedSolution {
  std::vector<double> control;               // K x C x 2, N, for any K; empty if there is none
  std::vector<double> durations;             // s, of the K intervals; empty: equally long
  std::vector<double> initial_state;         // B x 4; empty if the file does not have it
  std::map<std::string, double> parameters;  // values of design parameters, by their names
};

// Reads JSON (a run of saltus_solve --json, a document with one run, or an object with the keys "control", "durations",
// "position", "velocity" and "parameters", all optional) or NPZ ("control" of K x C x 2 or, of one disc, K x 2 numbers,
// "durations" of K, "initial_state" of B x 4, "parameter_names" and "parameters"). Other keys are not looked at. Throws
// InputError, which begins with `flag`, if sizes are not those of the scene.
SavedSolution ReadSolution(const std::string& flag, const std::string& path, const Scene& scene);

// Reads the run of a document; messages begin with `name`.
SavedSolution SolutionOf(const std::string& name, const Json& run, const Scene& scene);

// Takes over the values of the scene's design parameters; those that the solution does not have stay. Throws InputError
// if one is beyond its bounds.
void TakeParameters(const std::string& flag, const SavedSolution& solution, Scene* scene);

// Takes over these, and the velocities or positions that the scene leaves free. Throws InputError if the others are not
// those of the scene: then it is a solution of another problem.
void StartFrom(const std::string& flag, const SavedSolution& solution, Scene* scene);

// Reads a gradient to be audited beside those of the contact models, in the format of docs/explanation/gradients.md
// ("Externally computed gradients"). Its name is the path unless the file has one. Throws InputError.
ExternalGradient ReadExternalGradient(const std::string& path, const Scene& scene);

// Reads saved motions, of saltus or of another simulator, in the formats of docs/how-to/replays.md; a document of
// saltus_solve --json --states has a list "runs" of them. Velocities that are missing are differences of the positions,
// and "exact_" stands before what moves on arcs of constant acceleration between the times. `scene` stands in for what
// the file says of bodies. The model of a motion is empty if the file names none. Throws InputError with the key.
Replay ReadReplayFile(const std::string& path, const std::optional<Scene>& scene);

}  // namespace saltus
