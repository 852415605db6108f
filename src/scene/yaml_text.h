// The text of a scene file: what may stand in it before anything is read out of it.
#pragma once

#include <yaml-cpp/yaml.h>

#include <string>
#include <string_view>
#include <vector>

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

}  // namespace saltus::internal
