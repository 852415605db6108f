// `saltus_scene`: writes a generated scene as a scene file.
#include <gflags/gflags.h>

#include <iostream>

#include "programs/program.h"
#include "saltus/scene/scene_file.h"
#include "scene/control_problems.h"
#include "scene/scene_generators.h"

DEFINE_string(
    kind, "gas",
    "kind of scene: gas (in a box with four walls), break (a cue ball and a triangle of discs), pile (discs that fall "
    "between two walls) or control (a control problem of one of ten kinds, the seed modulo 10)");
DEFINE_int32(discs, 100, "number of discs, the cue ball included");
DEFINE_int64(seed, 1, "seed of the random numbers; the same seed gives the same scene");
DECLARE_double(restitution);
DECLARE_int32(steps);

namespace saltus {
namespace {

// Returns the options of a kind, with the values of the flags.
template <typename Options>
Options ReadOptions(int fewest) {
  constexpr int kMost = 1000;  // a scene file is read with care for every pair, and has at most a megabyte
  if (FLAGS_discs < fewest || FLAGS_discs > kMost) {
    throw InputError("--discs must lie in " + std::to_string(fewest) + ".." + std::to_string(kMost));
  }
  Options options{.discs = FLAGS_discs};
  if (IsGiven("steps")) options.steps = FLAGS_steps;
  if (IsGiven("restitution")) options.restitution = FLAGS_restitution;
  return options;
}

Scene GenerateControlProblem() {
  if (FLAGS_seed < 0) throw InputError("--seed must not be negative");
  if (IsGiven("discs")) throw InputError("--discs: a control problem has those of its kind");
  Scene scene = ControlProblem(FLAGS_seed);
  if (IsGiven("steps")) scene.steps = FLAGS_steps;
  if (IsGiven("restitution")) scene.contact.restitution = FLAGS_restitution;
  return scene;
}

Scene Generate() {
  if (FLAGS_kind == "gas") return GasInABox(ReadOptions<GasOptions>(1), FLAGS_seed);
  if (FLAGS_kind == "break") return BilliardBreak(ReadOptions<BreakOptions>(2), FLAGS_seed);
  if (FLAGS_kind == "pile") return FallingPile(ReadOptions<PileOptions>(1), FLAGS_seed);
  if (FLAGS_kind == "control") return GenerateControlProblem();
  throw InputError("--kind=" + FLAGS_kind + "; expected gas, break, pile or control");
}

}  // namespace

int SceneMain(int argc, char** argv) {
  return RunMain(argc, argv, FindProgram("saltus_scene"), [] {
    const Scene scene = Generate();
    if (const std::optional<SceneError> error = Validate(scene)) throw InputError(error->key + ": " + error->message);
    std::cout << WriteScene(scene);
    return kDone;
  });
}

}  // namespace saltus
