// Values in the tree of a scene file. What is not as expected throws SceneFileFailure with its line and path.
#pragma once

#include <yaml-cpp/yaml.h>

#include <string>
#include <vector>

namespace saltus::internal {

// A YAML value, and where it stands.
struct Value {
  YAML::Node node;
  std::string path;
  int line;
};

// What stands there, in words.
std::string Describe(const YAML::Node& node);

[[noreturn]] void Fail(const Value& value, const std::string& message);
[[noreturn]] void FailExpected(const Value& value, const std::string& expected);

double ReadNumber(const Value& value);
// The same, with the words for what else may stand there.
double ReadNumber(const Value& value, const char* expected);
int ReadSteps(const Value& value);
bool ReadBool(const Value& value);
const std::string& ReadName(const Value& value);
// Position in `choices` of the one that is given.
int ReadChoice(const Value& value, const std::vector<std::string>& choices);

}  // namespace saltus::internal
