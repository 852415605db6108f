// Random scenes by the exact contact model, as many as wanted: see checks.h. One line for each thing that was counted,
// and for each kind of failure and of refusal the first seeds that show it. Scenes run in processes, so that one that
// crashes or does not end is a failure of its own. Not part of the tests but for a few scenes.
#include <gflags/gflags.h>

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <iostream>
#include <sstream>

#include "base/interrupt.h"
#include "campaign/checks.h"
#include "campaign/scenes.h"
#include "output/progress.h"
#include "output/table.h"
#include "programs/program.h"
#include "saltus/scene/scene_file.h"
#include "sweep/executor.h"

DEFINE_int64(scenes, 1000, "how many");
DEFINE_int64(seed, 1, "of the first scene; the next has the next");
DEFINE_int64(gradient_every, 100, "of so many scenes one has its gradient checked; 0: none");
DEFINE_double(scene_seconds, 300, "what takes longer hangs");
DEFINE_double(time_limit, 0, "s; begins no scene after that (0: none)");
DEFINE_int64(only, -1, "run this seed alone, gradient included");
DEFINE_bool(edges, false, "scenes among segments, polygons and arcs, and on tables");
DEFINE_bool(spin, false, "discs spin");
DEFINE_bool(at_once, false, "scenes with events at the same time, every gradient entry checked on both sides");
DEFINE_bool(print, false, "with --only: print the scene as YAML");

namespace saltus {
namespace {

using campaign::Counts;

constexpr size_t kSeedsShown = 10;

std::string Encode(const Counts& counts) {
  std::string text;
  for (const auto& [what, number] : counts) text += std::to_string(number) + " " + what + "\n";
  return text;
}

Counts Decode(const std::string& text) {
  Counts counts;
  std::istringstream lines(text);
  int64_t number = 0;
  for (std::string what; lines >> number && std::getline(lines >> std::ws, what);) counts[what] = number;
  return counts;
}

campaign::NamedScene SceneOf(int64_t seed) {
  const auto number = static_cast<std::uint32_t>(seed);
  if (FLAGS_at_once) return campaign::RandomSceneAtOnce(number);
  campaign::NamedScene scene = FLAGS_edges ? campaign::RandomEdgeScene(number) : campaign::RandomScene(number);
  return FLAGS_spin ? campaign::WithSpin(std::move(scene), number) : scene;
}

Counts RunScene(int64_t seed, bool gradient) {
  const campaign::NamedScene scene = SceneOf(seed);
  Counts counts = FLAGS_at_once ? campaign::CheckAtOnce(scene.scene)
                                : campaign::Check(scene.scene, static_cast<std::uint32_t>(seed), gradient);
  counts["scenes"] = 1;
  counts["scenes of kind " + scene.kind] = 1;
  return counts;
}

class Tally {
 public:
  void Add(const WorkerPool::Result& result) {
    Counts counts;
    if (result.end == WorkerPool::End::kAnswered) counts = Decode(result.text);
    if (result.end == WorkerPool::End::kDied)
      counts = {{"scenes", 1}, {campaign::kFailure + ("crash: " + result.text), 1}};
    if (result.end == WorkerPool::End::kTooLate)
      counts = {{"scenes", 1}, {campaign::kFailure + std::string("hangs"), 1}};
    for (const auto& [what, number] : counts) {
      total_[what] += number;
      const bool failure = what.starts_with(campaign::kFailure);
      failed_ = failed_ || failure;
      if (!failure && !what.starts_with(campaign::kRefusal)) continue;
      std::vector<int64_t>& seeds = seeds_[what];
      seeds.insert(std::upper_bound(seeds.begin(), seeds.end(), result.task), result.task);
      seeds.resize(std::min(seeds.size(), kSeedsShown));
    }
  }

  bool failed() const { return failed_; }

  std::string ToText() const {
    Table table({{"what"}, {"how many"}, {"seeds"}});
    for (const auto& [what, number] : total_) {
      std::string list;
      if (const auto found = seeds_.find(what); found != seeds_.end()) {
        for (const int64_t seed : found->second) list += (list.empty() ? "" : " ") + std::to_string(seed);
      }
      table.AddRow({what, number, list});
    }
    return table.ToText(LayoutOfStandardOutput());
  }

 private:
  Counts total_;
  std::map<std::string, std::vector<int64_t>> seeds_;
  bool failed_ = false;
};

int RunOne() {
  if (FLAGS_print) std::cout << WriteScene(SceneOf(FLAGS_only).scene);
  const Counts counts = RunScene(FLAGS_only, /*gradient=*/true);
  std::cerr << Encode(counts);
  const bool failed = std::any_of(
      counts.begin(), counts.end(), [](auto& count) { return count.first.starts_with(campaign::kFailure); });
  return failed ? kAnswerFailed : kDone;
}

int RunAll() {
  using Clock = std::chrono::steady_clock;
  const InterruptGuard guard;
  WorkerPool pool(ThreadsFromFlags(), FLAGS_scene_seconds, [](int64_t seed) {
    return Encode(RunScene(seed, FLAGS_gradient_every > 0 && seed % FLAGS_gradient_every == 0));
  });
  Progress progress(ProgressFromFlags(), stderr, "random scenes", FLAGS_scenes);
  const Clock::time_point start = Clock::now();
  const auto go_on = [&] {
    const std::chrono::duration<double> spent = Clock::now() - start;
    return !InterruptGuard::Interrupted() && (FLAGS_time_limit <= 0 || spent.count() < FLAGS_time_limit);
  };
  const int64_t end = FLAGS_seed + FLAGS_scenes;
  int64_t next = FLAGS_seed;
  Tally tally;
  for (bool more = true; (more = more && next < end && go_on()) || pool.HasBusy();) {
    while (more && next < end && pool.HasIdle()) pool.Start(next++);
    for (const WorkerPool::Result& result : pool.Wait(std::chrono::milliseconds(100))) {
      tally.Add(result);
      progress.Advance();
    }
  }
  progress.Finish();
  std::cout << "seeds " << FLAGS_seed << " to " << next - 1 << "\n\n" << tally.ToText();
  if (next < end) std::cout << "\nstopped; go on with --seed=" << next << " --scenes=" << end - next << "\n";
  return tally.failed() || next < end ? kAnswerFailed : kDone;
}

}  // namespace
}  // namespace saltus

int main(int argc, char** argv) {
  const saltus::Program program = {
      "random_scenes",
      "Random scenes by exact events",
      {"--scenes=1000000 [--seed=1]"},
      {{"Scenes", {"scenes=N", "seed=N", "gradient_every=N", "edges", "spin", "at_once", "only=SEED", "print"}},
       {"Limits", {"scene_seconds=S", "time_limit=S", "threads=N"}},
       {"Output", {"progress=auto|plain|none"}}}};
  return saltus::RunMain(argc, argv, program, [] {
    const auto in_range = [](int64_t seed) { return 0 <= seed && seed <= UINT32_MAX; };
    if (FLAGS_at_once && (FLAGS_edges || FLAGS_spin)) {
      throw saltus::InputError("--at_once: expected neither --edges nor --spin with it");
    }
    if (FLAGS_scenes < 1 || !in_range(FLAGS_seed) || !in_range(FLAGS_seed + FLAGS_scenes - 1) ||
        FLAGS_only > UINT32_MAX) {
      throw saltus::InputError("--scenes, --seed and --only: expected seeds in 0..4294967295");
    }
    return FLAGS_only >= 0 ? saltus::RunOne() : saltus::RunAll();
  });
}
