// The YAML of scene files: checks of the text before it is read, and values of the tree. Errors are thrown as
// SceneFileFailure with line and path.
#pragma once

#include <yaml-cpp/yaml.h>

#include <functional>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "saltus/scene/scene_file.h"

namespace saltus::internal {

// The exception of the readers of scene files, thrown beside those of yaml-cpp.
struct SceneFileFailure {
  int line;
  std::string key;
  std::string message;
};

// Returns `text` on one line, without control characters, cut at a character of UTF-8.
std::string Printable(std::string_view text);

// Parses one document without anchors, aliases and tags, not deeper than kMaxSceneDepth.
YAML::Node LoadYaml(std::string_view text);

// Calls `use` with the tree of a text, or of a file. Returns why there is none, or what `use` throws: a
// SceneFileFailure. `name`: of the text, in errors.
using UseTree = std::function<void(const YAML::Node& root)>;
std::optional<SceneFileError> ReadYaml(std::string_view text, const std::string& name, const UseTree& use);
std::optional<SceneFileError> ReadYamlFile(const std::string& path, const UseTree& use);

// A YAML value, and where it stands.
struct Value {
  YAML::Node node;
  std::string path;
  int line;
};

// Describes a node in words, for messages.
std::string Describe(const YAML::Node& node);

[[noreturn]] void Fail(const Value& value, const std::string& message);
[[noreturn]] void FailExpected(const Value& value, const std::string& expected);

double ReadNumber(const Value& value, const char* expected = "a finite number");
int ReadSteps(const Value& value);
bool ReadBool(const Value& value);
const std::string& ReadName(const Value& value);
// Returns the index in `choices` of the given one.
int ReadChoice(const Value& value, const std::vector<std::string>& choices);

}  // namespace saltus::internal
