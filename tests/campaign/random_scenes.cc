// Random scenes by the exact contact model, as many as wanted: see checks.h. One line for each thing that was counted,
// and for each kind of failure and of refusal the first seeds that show it. Scenes run in processes, so that one that
// crashes or does not end is a failure of its own. Not part of the tests but for a few scenes.
#include <fcntl.h>
#include <gflags/gflags.h>
#include <glog/logging.h>
#include <poll.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <csignal>
#include <cstdio>
#include <cstring>
#include <iostream>
#include <optional>
#include <sstream>

#include "base/interrupt.h"
#include "base/table.h"
#include "campaign/checks.h"
#include "campaign/scenes.h"
#include "output/progress.h"
#include "programs/program.h"
#include "saltus/scene/scene_file.h"

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

// A process that checks one scene and writes what it counts into a pipe.
struct Child {
  using Clock = std::chrono::steady_clock;

  int64_t seed = 0;
  pid_t process = -1;
  int pipe = -1;
  std::string text;
  Clock::time_point deadline;

  static Child Start(int64_t seed) {
    int ends[2];
    PCHECK(pipe2(ends, O_CLOEXEC) == 0);
    Child child{
        seed, fork(), ends[0], "", Clock::now() + std::chrono::milliseconds(int64_t(1e3 * FLAGS_scene_seconds))};
    PCHECK(child.process >= 0);
    if (child.process == 0) {
      prctl(PR_SET_PDEATHSIG, SIGKILL);
      const std::string text = Encode(RunScene(seed, FLAGS_gradient_every > 0 && seed % FLAGS_gradient_every == 0));
      _exit(write(ends[1], text.data(), text.size()) == std::ssize(text) ? 0 : 1);
    }
    close(ends[1]);
    return child;
  }

  // Returns what the process has counted or how it ended, std::nullopt while it is at work.
  std::optional<Counts> Finish(bool readable) {
    std::array<char, 4096> part;
    const ssize_t size = readable ? read(pipe, part.data(), part.size()) : -1;
    if (size > 0) text.append(part.data(), size);
    const bool late = Clock::now() >= deadline;
    if (size != 0 && !late) return std::nullopt;
    if (late) kill(process, SIGKILL);
    int status = 0;
    waitpid(process, &status, 0);
    close(pipe);
    if (WIFEXITED(status) && WEXITSTATUS(status) == 0) return Decode(text);
    const std::string how = late                  ? "hangs"
                            : WIFSIGNALED(status) ? std::string("crash: ") + strsignal(WTERMSIG(status))
                                                  : "crash: exit code " + std::to_string(WEXITSTATUS(status));
    return Counts{{"scenes", 1}, {campaign::kFailure + how, 1}};
  }
};

class Tally {
 public:
  void Add(int64_t seed, const Counts& counts) {
    for (const auto& [what, number] : counts) {
      total_[what] += number;
      const bool failure = what.starts_with(campaign::kFailure);
      failed_ = failed_ || failure;
      if (!failure && !what.starts_with(campaign::kRefusal)) continue;
      std::vector<int64_t>& seeds = seeds_[what];
      seeds.insert(std::upper_bound(seeds.begin(), seeds.end(), seed), seed);
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
  Progress progress(ProgressFromFlags(), stderr, "random scenes", FLAGS_scenes);
  const Clock::time_point start = Clock::now();
  const auto go_on = [&] {
    const std::chrono::duration<double> spent = Clock::now() - start;
    return !InterruptGuard::Interrupted() && (FLAGS_time_limit <= 0 || spent.count() < FLAGS_time_limit);
  };
  const int64_t end = FLAGS_seed + FLAGS_scenes;
  int64_t next = FLAGS_seed;
  Tally tally;
  std::vector<Child> children;
  const size_t most = ThreadsFromFlags();
  for (bool more = true; (more = more && next < end && go_on()) || !children.empty();) {
    while (more && next < end && children.size() < most) children.push_back(Child::Start(next++));
    std::vector<pollfd> pipes;
    for (const Child& child : children) pipes.push_back({child.pipe, POLLIN, 0});
    poll(pipes.data(), pipes.size(), 100);
    for (size_t i = children.size(); i-- > 0;) {
      const std::optional<Counts> counts = children[i].Finish(pipes[i].revents != 0);
      if (!counts) continue;
      tally.Add(children[i].seed, *counts);
      children.erase(children.begin() + static_cast<std::ptrdiff_t>(i));
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
