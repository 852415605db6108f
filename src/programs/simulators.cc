#include "programs/simulators.h"

#include <gflags/gflags.h>

#include <algorithm>
#include <cctype>
#include <cmath>
#include <filesystem>
#include <iostream>
#include <map>
#include <mutex>
#include <sstream>

#include "base/file.h"

DEFINE_string(simulate, "",
              "command of a simulator of your own: [NAME=]COMMAND, or @FILE with one such command per line");
DEFINE_double(simulate_seconds, 30, "time, s, after which a simulator that does not answer has failed");

namespace saltus {
namespace {

constexpr std::size_t kMostListBytes = 1 << 20;

bool IsOfName(char c) { return std::isalnum(static_cast<unsigned char>(c)) != 0 || c == '_' || c == '-' || c == '.'; }

// Every value that --simulate was given. A flag of gflags has its last value only; its validator is told each.
std::vector<std::string>& GivenValues() {
  static std::vector<std::string>& values = *new std::vector<std::string>;
  return values;
}
bool AddGivenValue(const char*, const std::string& value) {
  if (!value.empty()) GivenValues().push_back(value);  // empty is the default
  return true;
}
DEFINE_validator(simulate, &AddGivenValue);

std::vector<std::string> LinesOf(const std::string& path) {
  const StatusOr<std::string> text = ReadFile(path, kMostListBytes);
  if (!text.ok()) throw InputError("--simulate=@" + path + ": " + text.status().message());
  std::vector<std::string> lines;
  for (const std::string& line : Split(*text, '\n')) {
    const std::size_t begin = line.find_first_not_of(" \t\r");
    if (begin != std::string::npos && line[begin] != '#') lines.push_back(line.substr(begin));
  }
  return lines;
}

std::string NameFrom(const std::string& command) {
  std::string last = "simulator";
  std::stringstream words(command);
  for (std::string word; words >> word;) {
    if (!word.starts_with("-")) last = std::filesystem::path(word).filename();
  }
  std::ranges::replace_if(
      last, [](char c) { return !IsOfName(c); }, '_');
  return last.empty() ? "simulator" : last;
}

std::vector<SimulatorCommand>& Kept() {
  static std::vector<SimulatorCommand>& kept = *new std::vector<SimulatorCommand>;
  return kept;
}

// Returns a black box that stays until the process ends, and with it the command.
std::shared_ptr<BlackBox> OpenedOnce(const std::string& contact) {
  static std::mutex& mutex = *new std::mutex;
  static auto& opened = *new std::map<std::string, std::shared_ptr<BlackBox>>;
  const std::lock_guard lock(mutex);
  std::shared_ptr<BlackBox>& box = opened[contact];
  if (box == nullptr) box = OpenSimulator(*FindSimulator(contact), /*copies=*/1);
  return box;
}

// "[NAME=]COMMAND"; without a name, one made of the last word of the command that is no flag. Throws InputError.
SimulatorCommand ParseSimulator(const std::string& text) {
  const std::size_t equals = text.find('=');
  const bool named = equals != std::string::npos && equals > 0 &&
                     std::all_of(text.begin(), text.begin() + static_cast<std::ptrdiff_t>(equals), IsOfName);
  SimulatorCommand simulator;
  simulator.command = named ? text.substr(equals + 1) : text;
  simulator.name = named ? text.substr(0, equals) : NameFrom(text);
  if (simulator.command.find_first_not_of(" \t") == std::string::npos) {
    throw InputError("--simulate=" + text + ": expected [NAME=]COMMAND");
  }
  return simulator;
}

}  // namespace

std::vector<SimulatorCommand> ReadSimulators() {
  if (!(FLAGS_simulate_seconds > 0) || !std::isfinite(FLAGS_simulate_seconds)) {
    throw InputError("--simulate_seconds must be positive");
  }
  std::vector<SimulatorCommand> simulators;
  const auto add = [&](const std::string& value) {
    SimulatorCommand simulator = ParseSimulator(value);
    for (const SimulatorCommand& other : simulators) {
      if (other.name == simulator.name) {
        throw InputError("--simulate=" + value + ": there are two of the name '" + other.name +
                         "'; name them, as in --simulate=NAME=COMMAND");
      }
    }
    simulators.push_back(std::move(simulator));
  };
  for (const std::string& value : GivenValues()) {
    if (!value.starts_with("@")) {
      add(value);
      continue;
    }
    for (const std::string& line : LinesOf(value.substr(1))) add(line);
  }
  return simulators;
}

std::vector<std::string> KeepSimulators(std::vector<SimulatorCommand> simulators) {
  std::vector<std::string> names;
  for (const SimulatorCommand& simulator : simulators) {
    if (FindContactModel(simulator.name) != nullptr) {
      throw InputError("--simulate: there is a contact model '" + simulator.name + "'; expected another name");
    }
    names.push_back(simulator.name);
  }
  Kept() = std::move(simulators);
  return names;
}

const SimulatorCommand* FindSimulator(const std::string& contact) {
  const auto found = std::ranges::find(Kept(), contact, &SimulatorCommand::name);
  return found == Kept().end() ? nullptr : &*found;
}

Contact ContactNamed(const std::string& contact, const Scene& scene) {
  return FindSimulator(contact) == nullptr ? Contact(contact) : MakeMeasuredContact(OpenedOnce(contact), scene);
}

bool HasFailed(const std::string& contact, const Scene& scene) {
  return FindSimulator(contact) != nullptr && !OpenedOnce(contact)->Describe(scene).error.empty();
}

CommandOptions OptionsOf(const SimulatorCommand& simulator, int copies) {
  const auto print = [name = simulator.name](const std::string& line) { std::cerr << name + ": " + line + "\n"; };
  return {simulator.name, simulator.command, copies, FLAGS_simulate_seconds, print};
}

std::shared_ptr<BlackBox> OpenSimulator(const SimulatorCommand& simulator, int copies) {
  return std::make_shared<CommandBox>(OptionsOf(simulator, copies));
}

}  // namespace saltus
