// The main of the problem executables: gradient table, then optimisation. Those include nothing else, so this header
// includes nothing that takes long to parse.
#pragma once

#include <memory>
#include <string>

namespace saltus {

struct Scene;

// The defaults that differ from program to program; flags given on the command line override them.
struct ProgramDefaults {
  std::string scene;          // file; empty if --scene must be given
  std::string solver = "gd";  // --solver
  double learning_rate = 0;   // 0: by what is optimised (10 for a control, 0.01 otherwise)
  int iterations = 1000;
  std::shared_ptr<const Scene> generated = nullptr;  // in place of any file; --scene is then an error
};

// A file or folder that comes with saltus, such as "problems/two_balls.yaml": of the installation that the running
// program belongs to, or else of the source tree.
std::string ShippedFile(const std::string& path);

int ProblemMain(int argc, char** argv, const ProgramDefaults& defaults);

}  // namespace saltus
