// The scene file that the README shows is the one it says it is.
#include <gtest/gtest.h>

#include <fstream>
#include <sstream>
#include <string>

#include "folders.h"
#include "saltus/io/scene_file.h"

namespace saltus {
namespace {

std::string ReadmeBlock(const std::string& language) {
  std::ifstream file(SourceFolder() + "/README.md");
  std::stringstream text;
  text << file.rdbuf();
  const std::string readme = text.str(), fence = "```";
  const std::size_t begin = readme.find(fence + language + "\n");
  if (begin == std::string::npos) return "";
  const std::size_t first = readme.find('\n', begin) + 1;
  return readme.substr(first, readme.find(fence, first) - first);
}

TEST(Readme, ShowsTheSceneOfTwoBalls) {
  const auto shown = ParseScene(ReadmeBlock("yaml"), "README.md");
  const auto kept = LoadSceneFile(SourceFolder() + "/problems/two_balls.yaml");
  ASSERT_TRUE(std::holds_alternative<Scene>(shown)) << std::get<SceneFileError>(shown).ToString();
  ASSERT_TRUE(std::holds_alternative<Scene>(kept)) << std::get<SceneFileError>(kept).ToString();
  EXPECT_EQ(WriteScene(std::get<Scene>(shown)), WriteScene(std::get<Scene>(kept)));
}

}  // namespace
}  // namespace saltus
