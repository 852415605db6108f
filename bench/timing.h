// How benchmarks here measure time: of the thread, so that what else the machine does disturbs little, and several
// things in turns, so that their ratio is of the same minute.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <string>
#include <utility>
#include <vector>

#include "paper/experiments.h"
#include "saltus/scene/scene_file.h"

namespace saltus {

// The time of one call of each function, s: the least of several blocks of calls, the functions' blocks in turns.
template <typename... Functions>
std::array<double, sizeof...(Functions)> TimeInTurns(const Functions&... functions) {
  constexpr int kBlocks = 9;
  constexpr double kBlockTime = 4e-3;  // s, at least
  std::array<double, sizeof...(Functions)> least;
  least.fill(HUGE_VAL);
  const auto time_block = [](const auto& function, double* least_time) {
    const double start = ThreadTime();
    double time = 0;
    int calls = 0;
    for (int batch = 1; time < kBlockTime; batch *= 2) {
      for (int i = 0; i < batch; ++i) function();
      calls += batch;
      time = ThreadTime() - start;
    }
    *least_time = std::min(*least_time, time / calls);
  };
  for (int block = 0; block < kBlocks; ++block) {
    size_t place = 0;
    (time_block(functions, &least[place++]), ...);
  }
  return least;
}

inline Scene ProblemScene(const std::string& name, int steps) {
  Scene scene = std::get<Scene>(LoadSceneFile(SALTUS_SOURCE_DIR "/problems/" + name + ".yaml"));
  scene.steps = steps;
  return scene;
}

}  // namespace saltus
