// The YAML of scene files: what may stand in the text before anything is read out of it, and values in the tree. What
// is not as expected throws SceneFileFailure with its line and path.
#pragma once

#include <yaml-cpp/yaml.h>

#include <functional>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "saltus/scene/scene_file.h"

namespace saltus::internal {

// Thrown by what reads a scene file, as yaml-cpp's own exceptions are.
struct SceneFileFailure {
  int line;
  std::string key;
  std::string message;
};

// `text` on one line, without control characters, cut at a character of UTF-8.
std::string Printable(std::string_view text);

// Words with commas in between.
std::string Join(const std::vector<std::string>& words);

// The tree of one document, without anchors, aliases and tags, and not deeper than kMaxSceneDepth.
YAML::Node LoadYaml(std::string_view text);

// Calls `use` with the tree of a file. Returns why there is none, or what `use` throws: a SceneFileFailure.
using UseTree = std::function<void(const YAML::Node& root)>;
std::optional<SceneFileError> ReadYamlFile(const std::string& path, const UseTree& use);

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

double ReadNumber(const Value& value, const char* expected = "a finite number");
int ReadSteps(const Value& value);
bool ReadBool(const Value& value);
const std::string& ReadName(const Value& value);
// Position in `choices` of the one that is given.
int ReadChoice(const Value& value, const std::vector<std::string>& choices);

}  // namespace saltus::internal
