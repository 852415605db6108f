#include "programs/replay_file.h"

#include <gflags/gflags.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <iostream>

#include "output/html_report.h"
#include "programs/program.h"
#include "programs/replay_reader.h"
#include "programs/replay_scene.h"

DECLARE_string(scene);
DEFINE_string(output, "replay.html", "HTML page to write");

namespace saltus {
namespace {

std::string StemOf(const std::string& path) { return std::filesystem::path(path).stem().string(); }

// A style for each motion: that of its contact model, unless another motion has it.
void SetStyles(std::vector<ReplayMotion>* motions, std::vector<std::string> models) {
  size_t next = 1;  // the first is of no contact model
  for (size_t i = 0; i < motions->size(); ++i) {
    const bool taken =
        models[i].empty() || std::find(models.begin(), models.begin() + i, models[i]) != models.begin() + i;
    while (taken && std::find(models.begin(), models.end(), ModelStyles()[next].model) != models.end() &&
           next + 1 < ModelStyles().size()) {
      ++next;
    }
    if (taken) models[i] = ModelStyles()[next].model;
    (*motions)[i].colour = StyleOf(models[i]).colour;
    (*motions)[i].dash = StyleOf(models[i]).dash;
  }
}

// Every n-th state, where there are more than a page shows.
void Thin(size_t most_rows, size_t width, ReplayMotion* motion) {
  const size_t rows = motion->times.size(), stride = (rows + most_rows - 1) / most_rows;
  if (stride < 2) return;
  std::vector<double> times, states, angles;
  const size_t discs = motion->angles.size() / rows;
  for (size_t k = 0; k < rows; ++k) {
    if (k % stride != 0 && k + 1 != rows) continue;
    times.push_back(motion->times[k]);
    states.insert(states.end(), motion->states.begin() + k * width, motion->states.begin() + (k + 1) * width);
    angles.insert(angles.end(), motion->angles.begin() + k * discs, motion->angles.begin() + (k + 1) * discs);
  }
  motion->times = std::move(times);
  motion->states = std::move(states);
  motion->angles = std::move(angles);
  motion->arcs = false;
  motion->remark += (motion->remark.empty() ? "" : "; ") + std::string("every ") + std::to_string(stride) +
                    (stride == 2   ? "nd"
                     : stride == 3 ? "rd"
                                   : "th") +
                    " state";
}

int WriteReplay() {
  const std::vector<std::string>& paths = FilesGiven();
  if (paths.empty()) throw InputError("expected a file to replay; -h describes the formats");
  std::optional<Scene> scene;
  if (!FLAGS_scene.empty()) scene = LoadScene(FLAGS_scene);
  const Replay replay = ReadReplay(paths, scene);
  std::string names;
  for (const std::string& path : paths) names += (names.empty() ? "" : ", ") + StemOf(path);
  HtmlReport page(names, "");
  page.AddReplay(replay, "Space plays and pauses, arrows step, with shift from impact to impact.");
  const Status status = page.Write(FLAGS_output);
  if (!status.ok()) throw OutputError(status.message());
  std::cout << FLAGS_output << std::endl;
  return kDone;
}

}  // namespace

Replay ReadReplay(const std::vector<std::string>& paths, const std::optional<Scene>& scene) {
  Replay replay;
  std::vector<std::string> models;
  for (const std::string& path : paths) {
    const ReplayFile file = ReadReplayFile(path, scene ? std::optional(ReplayOf(*scene)) : std::nullopt);
    if (replay.discs.empty()) {
      replay.discs = file.drawn.discs;
      replay.walls = file.drawn.walls;
      replay.outlines = file.drawn.outlines;
      replay.targets = file.drawn.targets;
    }
    const auto same = [](const ReplayDisc& l, const ReplayDisc& r) { return l.name == r.name && l.radius == r.radius; };
    if (!std::equal(replay.discs.begin(), replay.discs.end(), file.drawn.discs.begin(), file.drawn.discs.end(), same)) {
      throw InputError(path + ": its discs are not those of " + paths[0]);
    }
    for (size_t i = 0; i < file.drawn.motions.size(); ++i) {
      replay.motions.push_back(file.drawn.motions[i]);
      models.push_back(file.models[i]);
      if (paths.size() > 1) replay.motions.back().label = StemOf(path) + ": " + replay.motions.back().label;
    }
  }
  const size_t width = 4 * replay.discs.size(), motions = replay.motions.size();
  for (ReplayMotion& motion : replay.motions) {
    Thin(std::max<size_t>(2, kMostReplayNumbers / (width * motions)), width, &motion);
  }
  SetStyles(&replay.motions, std::move(models));
  return replay;
}

int ReplayMain(int argc, char** argv) { return RunMain(argc, argv, FindProgram("saltus_replay"), WriteReplay); }

}  // namespace saltus
