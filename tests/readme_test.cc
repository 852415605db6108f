// The scene file that the documentation shows is the one it says it is.
#include <gtest/gtest.h>

#include <fstream>
#include <sstream>
#include <string>

#include "folders.h"
#include "saltus/scene/scene_file.h"

namespace saltus {
namespace {

std::string BlockOf(const std::string& page, const std::string& language) {
  std::ifstream file(SourceFolder() + page);
  std::stringstream text;
  text << file.rdbuf();
  const std::string shown = text.str(), fence = "```";
  const std::size_t begin = shown.find(fence + language + "\n");
  if (begin == std::string::npos) return "";
  const std::size_t first = shown.find('\n', begin) + 1;
  return shown.substr(first, shown.find(fence, first) - first);
}

TEST(Documentation, ShowsTheSceneOfTwoBalls) {
  const auto shown = ParseScene(BlockOf("/docs/reference/scene-files.md", "yaml"), "scene-files.md");
  const auto kept = LoadSceneFile(SourceFolder() + "/problems/two_balls.yaml");
  ASSERT_TRUE(std::holds_alternative<Scene>(shown)) << std::get<SceneFileError>(shown).ToString();
  ASSERT_TRUE(std::holds_alternative<Scene>(kept)) << std::get<SceneFileError>(kept).ToString();
  EXPECT_EQ(WriteScene(std::get<Scene>(shown)), WriteScene(std::get<Scene>(kept)));
}

}  // namespace
}  // namespace saltus
