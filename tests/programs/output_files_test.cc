// Output files of every program: regular files are replaced, links followed, devices and FIFOs written through, and all
// else refused.
#include <fcntl.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/stat.h>
#include <sys/sysmacros.h>

#include <filesystem>
#include <fstream>
#include <functional>
#include <string>
#include <vector>

#include "base/file.h"
#include "programs/run_program.h"

namespace saltus {
namespace {

namespace fs = std::filesystem;
using testing::AllOf;
using testing::HasSubstr;
using testing::Not;

constexpr unsigned kNull = 3, kFull = 7;

// A copy of a character device of the kernel. Never the machine's own: a program that replaces it would do so here.
bool MakeDevice(const std::string& path, unsigned minor) {
  if (mknod(path.c_str(), S_IFCHR | 0666, makedev(1, minor)) != 0) return false;
  const int file = open(path.c_str(), O_WRONLY);
  if (file >= 0) close(file);
  return file >= 0;
}

const std::string kBalls = SceneFlag("two_balls") + "--contact=event --steps=24 --progress=none ";

// Files of a sweep that are read again, and must be regular ones.
bool IsOfStore(const std::string& name) { return name == "sweep.csv" || name == "sweep.study.json"; }

class OutputFiles : public testing::TestWithParam<std::string> {
 protected:
  OutputFiles() : folder_(TempFile("output_files")) {
    fs::remove_all(folder_);
    fs::create_directories(folder_);
  }
  ~OutputFiles() override { fs::remove_all(folder_); }

  std::string At(const std::string& name) const { return (folder_ / name).string(); }
  Outcome RunInto(const std::string& name) const { return RunProgram(GetParam() + "--output_dir=" + At(name)); }

  // The names of what the program writes.
  std::vector<std::string> Names() {
    const Outcome outcome = RunInto("plain");
    EXPECT_EQ(outcome.exit_code, 0) << outcome.errors;
    std::vector<std::string> names;
    for (const auto& entry : fs::directory_iterator(folder_ / "plain")) names.push_back(entry.path().filename());
    EXPECT_GE(names.size(), 2u);
    return names;
  }

  // A folder in which each of the names but those of the store stands for something else.
  void Fill(const std::string& name, const std::vector<std::string>& names,
            const std::function<bool(std::string)>& make) {
    fs::create_directories(folder_ / name);
    for (const std::string& file : names) {
      if (IsOfStore(file)) continue;
      if (!make(At(name + "/" + file))) GTEST_SKIP() << "devices cannot be made here";
    }
  }

  fs::path folder_;
};

TEST_P(OutputFiles, LinksAreFollowedAndStay) {
  const std::vector<std::string> names = Names();
  fs::create_directories(folder_ / "targets");
  fs::create_directories(folder_ / "links");
  for (std::size_t i = 0; i < names.size(); ++i) {
    fs::create_symlink("../targets/" + names[i], At("links/" + names[i]));
    if (i % 2 == 0 && !IsOfStore(names[i])) std::ofstream(At("targets/" + names[i])) << "old";  // else dangling
  }
  const Outcome outcome = RunInto("links");
  EXPECT_EQ(outcome.exit_code, 0) << outcome.errors;
  for (const std::string& name : names) {
    EXPECT_TRUE(fs::is_symlink(At("links/" + name))) << name;
    EXPECT_TRUE(fs::is_regular_file(fs::symlink_status(At("targets/" + name)))) << name;
    const StatusOr<std::string> text = ReadFile(At("targets/" + name));
    ASSERT_TRUE(text.ok());
    EXPECT_GT(text->size(), 3u) << name;
    if (name == "report.html") {
      EXPECT_THAT(*text, HasSubstr("</html>"));
    }
  }
}

TEST_P(OutputFiles, DevicesAreWrittenThrough) {
  const std::vector<std::string> names = Names();
  Fill("null", names, [](const std::string& path) { return MakeDevice(path, kNull); });
  if (IsSkipped()) return;
  EXPECT_EQ(RunInto("null").exit_code, 0);
  for (const std::string& name : names) {
    if (IsOfStore(name)) continue;
    EXPECT_TRUE(fs::is_character_file(fs::symlink_status(At("null/" + name)))) << name;
  }
}

// A full device is an error, which costs nothing else.
TEST_P(OutputFiles, FullDevicesAreErrors) {
  const std::vector<std::string> names = Names();
  Fill("full", names, [](const std::string& path) { return MakeDevice(path, kFull); });
  if (IsSkipped()) return;
  const Outcome outcome = RunInto("full");
  EXPECT_EQ(outcome.exit_code, 1);
  EXPECT_THAT(outcome.errors, AllOf(HasSubstr("error: "), HasSubstr("cannot write: No space left")));
  EXPECT_FALSE(outcome.output.empty());
  for (const std::string& name : names) {
    if (IsOfStore(name)) continue;
    EXPECT_TRUE(fs::is_character_file(fs::symlink_status(At("full/" + name)))) << name;
  }
}

TEST_P(OutputFiles, FoldersAreRefused) {
  const std::vector<std::string> names = Names();
  Fill("folders", names, [](const std::string& path) { return fs::create_directories(path); });
  const Outcome outcome = RunInto("folders");
  EXPECT_EQ(outcome.exit_code, 1);
  EXPECT_THAT(outcome.errors, HasSubstr("it is a directory"));
  EXPECT_FALSE(outcome.output.empty());
}

TEST_P(OutputFiles, AFifoTakesAReport) {
  fs::create_directories(folder_ / "fifo");
  ASSERT_EQ(mkfifo(At("fifo/report.html").c_str(), 0600), 0);
  const Outcome outcome =
      RunCommand("cat " + At("fifo/report.html") + " >" + At("read") + " & " + BuildFolder() + "/bin/" + GetParam() +
                 "--output_dir=" + At("fifo") + " >/dev/null; code=$?; wait; exit $code");
  EXPECT_EQ(outcome.exit_code, 0) << outcome.errors;
  EXPECT_TRUE(fs::is_fifo(At("fifo/report.html")));
  EXPECT_THAT(*ReadFile(At("read")), HasSubstr("</html>"));
}

INSTANTIATE_TEST_SUITE_P(Programs, OutputFiles,
                         testing::Values("saltus_audit" + kBalls, "saltus_solve --solver=ceres_event" + kBalls,
                                         "saltus_sweep --solver=none --sweep=steps=8,16" + kBalls,
                                         "two_balls --solver=none --contact=event --steps=24 --progress=none ",
                                         "saltus_identify --scene=" + SourceFolder() + "/problems/drops/drops.yaml " +
                                             "--recording=" + SourceFolder() + "/problems/drops/drop_1.csv " +
                                             "--law=network:1 --starts=2 --progress=none "),
                         [](const auto& test) { return test.param.substr(0, test.param.find(' ')); });

// Rows are appended to a file that is read again, so it is a regular one.
TEST(Store, WhatIsNoRegularFileIsRefused) {
  const std::string folder = TempFile("output_files_store");
  for (const std::string name : {"sweep.csv", "sweep.study.json"}) {
    fs::remove_all(folder);
    fs::create_directories(folder);
    const std::string path = folder + "/" + name;
    ASSERT_EQ(mkfifo(path.c_str(), 0600), 0);
    const Outcome outcome =
        RunProgram("saltus_sweep --solver=none --sweep=steps=8,16" + kBalls + "--output_dir=" + folder);
    EXPECT_EQ(outcome.exit_code, 2) << name;
    EXPECT_THAT(outcome.errors, HasSubstr(name + ": it is a FIFO, expected a regular file or none"));
    EXPECT_TRUE(fs::is_fifo(path));
  }
  fs::remove_all(folder);
}

class ReplayProgram : public testing::Test {
 protected:
  ReplayProgram() : folder_(TempFile("output_files_replay")) {
    fs::remove_all(folder_);
    fs::create_directories(folder_);
    std::ofstream(folder_ / "motion.json")
        << R"({"bodies": [{"name": "ball", "radius": 0.2}], "times": [0, 0.1], "states": [[[0, 1, 2, 0]], [[0.2, 1, 2, 0]]]})";
  }
  ~ReplayProgram() override { fs::remove_all(folder_); }
  std::string Command(const std::string& output) const {
    return "saltus_replay " + (folder_ / "motion.json").string() + " --output=" + output;
  }
  fs::path folder_;
};

TEST_F(ReplayProgram, WritesThroughADevice) {
  const std::string null = (folder_ / "null").string(), full = (folder_ / "full").string();
  if (!MakeDevice(null, kNull) || !MakeDevice(full, kFull)) GTEST_SKIP() << "devices cannot be made here";
  EXPECT_EQ(RunProgram(Command(null)).exit_code, 0);
  const Outcome lost = RunProgram(Command(full));
  EXPECT_EQ(lost.exit_code, 1);
  EXPECT_THAT(lost.errors, HasSubstr("No space left"));
  for (const std::string& path : {null, full}) EXPECT_TRUE(fs::is_character_file(fs::symlink_status(path))) << path;
}

TEST_F(ReplayProgram, WritesThroughALinkToStandardOutput) {
  const Outcome outcome = RunProgram(Command("/dev/stdout") + " | cat");
  EXPECT_THAT(outcome.output, AllOf(HasSubstr("</html>"), HasSubstr("/dev/stdout\n")));
  EXPECT_THAT(outcome.errors, Not(HasSubstr("error")));
}

}  // namespace
}  // namespace saltus
