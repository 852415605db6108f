// A user's first program: it reads a scene, optimises it and prints the loss. Exit code 0 if the loss is the published
// one (Zhong, Han, Brikis 2022, task 3).
#include <cmath>
#include <iostream>

#include "saltus/scene/scene_file.h"
#include "saltus/solve/solver.h"

int main(int argc, char** argv) {
  if (argc != 2) {
    std::cerr << "usage: consumer two_balls.yaml\n";
    return 2;
  }
  const auto scene = saltus::LoadSceneFile(argv[1]);
  if (const auto* error = std::get_if<saltus::SceneFileError>(&scene)) {
    std::cerr << error->ToString() << '\n';
    return 2;
  }
  const saltus::SolveRequest request{.scene = std::get<saltus::Scene>(scene), .contact = "direct_toi"};
  const saltus::SolveReport report =
      saltus::Solve("gd", request, {.limits = {.iterations = 999}, .descent = {.learning_rate = 10}});
  std::cout << "loss " << report.guess.loss << " -> " << report.solution.loss << ", "
            << saltus::TerminationToString(report.termination) << '\n';
  return std::abs(report.solution.loss - 1.39581298828) < 1e-5 ? 0 : 1;
}
