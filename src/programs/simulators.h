// --simulate: commands that are black boxes.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "blackbox/session.h"
#include "programs/program.h"
#include "saltus/audit/black_box.h"

namespace saltus {

// A command, and the name of its row.
struct SimulatorCommand {
  std::string name;
  std::string command;
};

// Every --simulate=[NAME=]COMMAND that was given, on the command line, in a flag file or in the environment, and the
// lines of every @FILE. After gflags has read the flags. Throws InputError.
std::vector<SimulatorCommand> ReadSimulators();

// For programs to which a simulator is one more value of --contact: keeps them for the functions below, and returns
// their names. To be called once.
std::vector<std::string> KeepSimulators(std::vector<SimulatorCommand> simulators);
// The command of a kept one, or null.
const SimulatorCommand* FindSimulator(const std::string& contact);
// The contact model of a name: a kept simulator, of which this process runs one copy, or one of the registry.
Contact ContactNamed(const std::string& contact, const Scene& scene);
// Whether a kept simulator has failed.
bool HasFailed(const std::string& contact, const Scene& scene);

// With what prints each line of its standard error under its name.
CommandOptions OptionsOf(const SimulatorCommand& simulator, int copies);
// Opens a simulator with so many copies of its command, and forwards its standard error.
std::shared_ptr<BlackBox> OpenSimulator(const SimulatorCommand& simulator, int copies);

}  // namespace saltus
