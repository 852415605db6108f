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

// Reads a gradient from a JSON file, to be audited beside those of the contact models. Keys: position, velocity,
// control and parameters, and of discs that spin angle and angular_velocity, as in every gradient that the programs
// print. Lists may end early, [x, y] may be null if it is not known, and parameters are not looked at. Besides: name
// (default: the path), tolerance (absolute, default 0) and intervals (equal parts of the horizon that rows of the
// control stand for; default: one a step). Or an object with such a gradient under the key gradient, as in the audits
// of saltus_audit --json: named, and its intervals known, by its contact model. Throws InputError.
ExternalGradient ReadExternalGradient(const std::string& path, const Scene& scene);

// Reads saved motions, of saltus or of another simulator, from NPZ or JSON:
//
//   bodies   [{ "name", "radius", "fixed" }]          fixed is false unless given
//   planes   [{ "name", "point", "normal" }]          default none; likewise segments, polygons, arcs and pockets as
//                                                     in scene files
//   times    n numbers that do not fall, s
//   states   n x B x [p_x, p_y, v_x, v_y]; without velocities, these are differences of the positions; of discs
//            that spin angle and angular velocity follow, and what follows then is not looked at
//   touches  [{ "a", "b", "begin", "end", "impulse" }], default none; end (begin) and impulse ([0, 0]) may be missing
//
// and the same with "exact_" before them, for arcs of constant acceleration between the times; or a list "runs" of
// such, with "contact" and "solver", as saltus_solve --json --states prints them. In NPZ files, as saltus_solve writes
// them, bodies are "scene" (the text of a scene file) or "radius" (B) and "name" (B), and "rotations" (n x B x 2) may
// have the angles and angular velocities. Throws InputError with the key.
// `scene` stands in for what the file says of bodies. The model of a motion is empty if the file names none.
Replay ReadReplayFile(const std::string& path, const std::optional<Scene>& scene);

}  // namespace saltus
