// Runs the corpus of fuzzing, its seeds and its findings: no repaired fault comes back.
#include <gtest/gtest.h>

#include <filesystem>
#include <vector>

#include "base/file.h"
#include "folders.h"
#include "fuzz/targets.h"

namespace saltus {
namespace {

class FuzzCorpus : public testing::TestWithParam<fuzz::Target> {};

TEST_P(FuzzCorpus, IsReadOrRefused) {
  int files = 0;
  const std::string folder = SourceFolder() + "/tests/fuzz/corpus/" + GetParam().name;
  for (const auto& file : std::filesystem::directory_iterator(folder)) {
    SCOPED_TRACE(file.path());
#ifdef __SANITIZE_ADDRESS__
    if (file.path().filename() == "long") continue;  // a step of 1e24 s, which is refused after minutes of events
#endif
    GetParam().run(ReadFile(file.path()).value());
    ++files;
  }
  EXPECT_GT(files, 0);
}

TEST_P(FuzzCorpus, NothingIsReadOrRefused) { GetParam().run(""); }

INSTANTIATE_TEST_SUITE_P(Targets, FuzzCorpus,
                         testing::ValuesIn(std::vector<fuzz::Target>(fuzz::Targets().begin(), fuzz::Targets().end())),
                         [](const auto& target) { return std::string(target.param.name); });

}  // namespace
}  // namespace saltus
