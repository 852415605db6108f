// The options of a sweep: every numeric flag of the programs, some numbers of the scene, the contact model, the solver
// and the precision; or the scene itself, by the seed of a control problem (scene/control_problems.h).
//
// Beside the names in SweepOptionNames(), "<body>.<field>" is an option for every body of the scene: mass, radius,
// position_x, position_y, velocity_x, velocity_y, and force_x, force_y (of the initial control) if it is controlled,
// torque if it is turned. In a scene with materials restitution and friction have the names of scene_parameter.h, such
// as "restitution.rubber-steel".
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "programs/program.h"

namespace saltus {

// One entry of a sweep's table: null, a whole number, a finite number or text.
using SweepValue = Json;
using SweepRow = std::vector<SweepValue>;

// The number, or NaN for null and for text.
double ToNumber(const SweepValue& value);

// A program of a hybrid system (programs/hybrid_program.h) that is swept in the place of a scene. Its options are
// `names`, the values of its flag --set, "solver", "steps", "iterations" and "learning_rate", and with --feedback in
// its command "feedback_scale", "feedback_samples" and "feedback_seed".
struct SweepProgram {
  std::string command;             // for /bin/sh
  std::string name;                // of what it solves
  std::vector<std::string> names;  //
  bool feedback = false;           // the command has --feedback
};
// Keeps it for the functions below and for the points of a study. To be called once, before them.
void KeepProgram(SweepProgram program);
// Returns the kept program, null if none is kept.
const SweepProgram* KeptProgram();
// The JSON that a command line of the program prints. Throws InputError with what it prints if there is none.
Json RunProgram(const std::string& arguments, double seconds);

enum class SweepOptionKind { kReal, kInteger, kWord };

// Returns the kind of an option, std::nullopt if a sweep over `scene` has no such option.
std::optional<SweepOptionKind> FindSweepOption(const std::string& name, const Scene& scene);

// The options that do not depend on the scene.
std::vector<std::string> SweepOptionNames();

// The words that solver or precision accept. A contact model may have options: see registry.h.
std::vector<std::string> SweepWords(const std::string& name);

// The option that takes the place of the scene, so that it is set before all others.
inline constexpr const char* kSeedOption = "seed";

// Sets one option of a request; the scene that results is not validated. Precondition: the option exists, the value is
// a word that it accepts, or else a number. Throws InputError if the number is impossible for an option of solvers.
void SetSweepOption(const std::string& name, const SweepValue& value, Request* request);

}  // namespace saltus
