// How the programs end: exit codes, interrupts, and outputs that nobody takes.
#include <fcntl.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <pty.h>

#include <array>
#include <chrono>
#include <csignal>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <string>

#include "base/file.h"
#include "folders.h"
#include "programs/run_program.h"

namespace saltus {
namespace {

using namespace std::chrono_literals;
using nlohmann::json;
using testing::AllOf;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::Not;

// A command of each program that prints results, and ends with 0 where they can be printed.
const std::string kResults[] = {
    "saltus_solve" + SceneFlag("two_balls") + "--contact=event --solver=ceres_event --progress=none",
    "saltus_solve" + SceneFlag("two_balls") + "--contact=event --solver=ceres_event --progress=none --json",
    "saltus_audit" + SceneFlag("two_balls") + "--contact=event --progress=none",
    "saltus_sweep" + SceneFlag("two_balls") + "--contact=event --solver=none --sweep=steps=10,20 --progress=none",
    "two_balls --contact=event --solver=none --progress=none",
    "saltus_scene --discs=3",
    "saltus_solve --contact=list",
    "saltus_solve --solver=list",
    "saltus_solve --help",
    "saltus_audit --version"};

TEST(Ends, OutputThatIsLostIsAnError) {
  for (const std::string& command : kResults) {
    EXPECT_EQ(RunProgram(command).exit_code, 0) << command;
    for (const std::string to : {" >/dev/full", " >&-"}) {
      const Outcome outcome = RunProgram(command + to);
      EXPECT_EQ(outcome.exit_code, 1) << command << to;
      EXPECT_THAT(outcome.errors, HasSubstr("standard output")) << command << to;
    }
  }
}

TEST(Ends, AProgramWithoutStandardStreamsPrintsIntoNoFileOfItsOwn) {
  const std::string directory = TempFile("closed");
  const Outcome outcome = RunProgram(
      "saltus_sweep" + SceneFlag("two_balls") +
      "--contact=event --solver=none --sweep=steps=10,20 --progress=none --output_dir=" + directory + " <&- >&-");
  EXPECT_EQ(outcome.exit_code, 1);
  EXPECT_THAT(ContentsOf(directory + "/sweep.csv"), testing::StartsWith("steps,contact"));
  EXPECT_THAT(ContentsOf(directory + "/sweep.study.json"), Not(HasSubstr("steps,contact")));
  std::filesystem::remove_all(directory);
}

TEST(Ends, AReaderThatHasSeenEnoughIsNoError) {
  for (const std::string& command : kResults) {
    const Outcome outcome = RunProgram(command + " | head -n 1");
    EXPECT_EQ(outcome.exit_code, 0) << command;
    EXPECT_THAT(outcome.errors, IsEmpty()) << command;
  }
}

// Files are written even if nobody takes the tables, and tables printed even if files cannot be written.
TEST(Ends, OneLostOutputDoesNotCostTheOther) {
  const std::string directory = TempFile("files");
  const std::string solve = "saltus_solve" + SceneFlag("two_balls") +
                            "--contact=event --solver=ceres_event --progress=none --output_dir=" + directory;
  EXPECT_EQ(RunProgram(solve + " >/dev/full").exit_code, 1);
  const std::string file = directory + "/two_balls_event_ceres_event.npz";
  EXPECT_TRUE(std::filesystem::exists(file));
  std::filesystem::remove(file);
  std::filesystem::create_directories(file + "/in_the_way");
  const Outcome outcome = RunProgram(solve);
  EXPECT_EQ(outcome.exit_code, 1);
  EXPECT_THAT(outcome.errors, HasSubstr("ceres_event.npz"));
  EXPECT_THAT(outcome.output, HasSubstr("converged"));
  std::filesystem::remove_all(directory);
}

TEST(Ends, ARunThatIsNoAnswerIsExitCodeOneAndNamed) {
  const struct {
    std::string command, why;
  } cases[] = {
      {"--contact=event --solver=gd --iterations=3", "event gd: iteration_limit"},
      {"--contact=event --solver=ceres_event,gd --iterations=30", "1 of 2 runs (event gd: iteration_limit"},
      {"--contact=direct --solver=ceres_lbfgs", "direct ceres_lbfgs: no_progress"},
      {"--contact=direct_toi --solver=ceres_lagrangian --iterations=40", "direct_toi ceres_lagrangian: "},
  };
  for (const auto& [flags, why] : cases) {
    const Outcome outcome = RunProgram("saltus_solve --progress=none" + SceneFlag("two_balls") + flags);
    EXPECT_EQ(outcome.exit_code, 1) << flags;
    EXPECT_THAT(outcome.errors, HasSubstr(why)) << flags;
    EXPECT_EQ(std::count(outcome.errors.begin(), outcome.errors.end(), '\n'), 1) << outcome.errors;
  }
  // A solver that is not applicable is no failure beside a run that converges.
  EXPECT_EQ(RunProgram("saltus_solve --progress=none --contact=event --solver=ceres_event,grid_optimum" +
                       SceneFlag("multiple_collisions") + "--friction=0.1")
                .exit_code,
            RunProgram("saltus_solve --progress=none --contact=event --solver=ceres_event" +
                       SceneFlag("multiple_collisions") + "--friction=0.1")
                .exit_code);
}

// With so large a rate gradient descent jumps about.
TEST(Ends, GradientDescentReportsItsBestIterateToo) {
  const std::string command =
      "saltus_solve --progress=none --contact=direct_toi --solver=gd --iterations=60 "
      "--learning_rate=4000" +
      SceneFlag("two_balls");
  const Outcome outcome = RunProgram(command + "--json");
  EXPECT_EQ(outcome.exit_code, 1);
  const json run = json::parse(outcome.output)["runs"][0];
  const std::vector<double> losses = run["losses"];
  const auto least = std::min_element(losses.begin(), losses.end());
  EXPECT_EQ(run["best_loss"].get<double>(), *least);
  EXPECT_EQ(run["best_iteration"].get<int>(), least - losses.begin());
  EXPECT_EQ(run["final_loss"].get<double>(), losses.back());
  ASSERT_GT(run["final_loss"], run["best_loss"]);
  EXPECT_EQ(run["best_control"].size(), 480u);
  EXPECT_NE(run["best_control"], run["control"]);
  EXPECT_THAT(RunProgram(command).output, HasSubstr("best "));
}

TEST(Ends, MemoryThatRunsOutIsSaidAndCostsOneRun) {
  if (std::getenv("ASAN_OPTIONS") != nullptr) GTEST_SKIP() << "a sanitizer reserves more than the limit";
  const std::string limited = "sh -c 'ulimit -v 700000; exec \"$@\"' sh " + BuildFolder() +
                              "/bin/saltus_solve --progress=none --threads=1 " + SceneFlag("two_balls") +
                              "--contact=direct_toi --steps=10000000 ";
  const Outcome json_outcome = RunCommand(limited + "--solver=gd --iterations=1 --json");
  EXPECT_EQ(json_outcome.exit_code, 1);
  EXPECT_THAT(json_outcome.errors, HasSubstr("memory ran out"));
  const Outcome table = RunCommand(limited + "--solver=ceres_shooting");
  EXPECT_EQ(table.exit_code, 1);
  EXPECT_THAT(table.output, AllOf(HasSubstr("ceres_shooting"), HasSubstr("memory ran out")));
}

// With ever larger documents, memory runs out in making the states, in printing them, or in freeing them. OpenBLAS,
// where it is installed, reserves memory for each thread.
TEST(Ends, MemoryThatRunsOutInTheOutputCostsTheStatesOnly) {
  if (std::getenv("ASAN_OPTIONS") != nullptr) GTEST_SKIP() << "a sanitizer reserves more than the limit";
  const std::string directory = TempFile("memory");
  int without = 0;
  for (const int steps : {35000, 60000, 80000, 90000, 100000}) {
    std::filesystem::remove_all(directory);
    const Outcome outcome =
        RunCommand("sh -c 'ulimit -v 229376; OPENBLAS_NUM_THREADS=1 exec \"$@\"' sh " + BuildFolder() +
                   "/bin/saltus_solve --progress=none --threads=1 --contact=event --solver=none --json --states" +
                   SceneFlag("two_balls") + "--steps=" + std::to_string(steps) + " --output_dir=" + directory);
    SCOPED_TRACE(std::to_string(steps) + " steps\n" + outcome.errors);
    const json document = json::parse(outcome.output, nullptr, /*allow_exceptions=*/false);
    ASSERT_FALSE(document.is_discarded());
    const json& run = document["runs"][0];
    EXPECT_TRUE(run["loss"].is_number());
    EXPECT_EQ(outcome.exit_code == 0, run.contains("states") && run.contains("exact_states"));
    if (outcome.exit_code != 0) {
      ++without;
      EXPECT_EQ(outcome.exit_code, 1);
      EXPECT_THAT(outcome.errors, HasSubstr("memory ran out"));
    }
    EXPECT_TRUE(std::filesystem::exists(directory + "/two_balls_event_none.npz"));
  }
  EXPECT_GT(without, 0) << "the limit is no limit";
  std::filesystem::remove_all(directory);
}

TEST(Ends, MemoryThatRunsOutInAnAuditIsSaid) {
  if (std::getenv("ASAN_OPTIONS") != nullptr) GTEST_SKIP() << "a sanitizer reserves more than the limit";
  for (const std::string& flags :
       {std::string(), std::string("--json "), "--json --output_dir=" + TempFile("memory") + " "}) {
    for (const int mebibytes : {256, 384, 512}) {
      const Outcome outcome =
          RunCommand("sh -c 'ulimit -v " + std::to_string(mebibytes * 1024) + "; exec \"$@\"' sh " + BuildFolder() +
                     "/bin/saltus_audit --progress=none --threads=2 --contact=direct,event "
                     "--steps=1000000 --attribution_seconds=1 " +
                     flags + SceneFlag("two_balls"));
      EXPECT_TRUE(outcome.exit_code == 0 || outcome.exit_code == 1) << mebibytes << flags << outcome.errors;
      if (outcome.exit_code == 1) {
        EXPECT_THAT(outcome.errors, HasSubstr("memory ran out")) << mebibytes << flags;
      }
    }
  }
  std::filesystem::remove_all(TempFile("memory"));
}

// More than a file may hold is an error like a full disk, and no signal.
TEST(Ends, AFileThatBecomesTooLargeIsAnError) {
  const std::string directory = TempFile("large");
  const Outcome outcome = RunCommand("sh -c 'ulimit -f 4; exec \"$@\"' sh " + BuildFolder() +
                                     "/bin/saltus_solve --progress=none --contact=event --solver=none" +
                                     SceneFlag("two_balls") + "--output_dir=" + directory);
  EXPECT_EQ(outcome.exit_code, 1);
  EXPECT_THAT(outcome.errors, HasSubstr("cannot write: File too large"));
  EXPECT_THAT(outcome.output, HasSubstr("two_balls"));  // the table
  int files = 0;
  for ([[maybe_unused]] const auto& entry : std::filesystem::directory_iterator(directory)) ++files;
  EXPECT_EQ(files, 0) << "what is cut off is no file";
  std::filesystem::remove_all(directory);
}

TEST(Ends, AnAuditWithoutAGradientSaysWhy) {
  const Outcome outcome =
      RunProgram("saltus_audit --progress=none --contact=primal_descent,event --stiffness=1e15 --steps=24" +
                 SceneFlag("two_balls"));
  EXPECT_EQ(outcome.exit_code, 1);
  EXPECT_THAT(outcome.errors, HasSubstr("no gradient of 1 of 2 (primal_descent: the rollout fails: step "));
  EXPECT_EQ(std::count(outcome.errors.begin(), outcome.errors.end(), '\n'), 1) << outcome.errors;
}

// Ceres fails in some steps of a search, which the search takes note of.
TEST(Ends, TheLogOfCeresIsOff) {
  const Outcome outcome = RunProgram(
      "saltus_solve --progress=none --contact=event --solver=mode_search --steps=24 "
      "--iterations=15 --search_seconds=0" +
      SceneFlag("two_balls"));
  EXPECT_THAT(outcome.errors, testing::StartsWith("no answer from 1 of 1 runs"));
}

TEST(Ends, FilesThatAreNoneAreWrongInput) {
  const std::string directory = TempFile("directory"), self = TempFile("self");
  std::filesystem::create_directories(directory);
  std::ofstream(self) << "--steps=10\n--flagfile=" << self << "\n";
  const std::string audit = "saltus_audit --contact=event --progress=none" + SceneFlag("two_balls");
  const std::string sweep = "saltus_sweep --contact=event --progress=none" + SceneFlag("two_balls");
  const struct {
    std::string command, message;
  } cases[] = {
      {audit + "--given=" + directory, "directory"},
      {audit + "--given=/dev/zero", "/dev/zero"},
      {audit + "--given=/nonexistent", "/nonexistent"},
      {audit + "--given=/dev/null", "/dev/null"},
      {sweep + "--sweep=@" + directory, "directory"},
      {sweep + "--sweep=@/dev/zero", "/dev/zero"},
      {sweep + "--sweep=@/nonexistent", "/nonexistent"},
      {"saltus_audit --scene=" + directory, "directory"},
      {"saltus_audit --scene=/dev/zero", "/dev/zero"},
      {audit + "--flagfile=" + directory, "directory"},
      {audit + "--flagfile=/dev/zero", "/dev/zero"},
      {audit + "--flagfile /dev/zero", "/dev/zero"},
      {audit + "--flagfile=/nonexistent", "/nonexistent"},
      {audit + "--flagfile=" + self, self},
  };
  for (const auto& [command, message] : cases) {
    const Outcome outcome = RunProgram(command);
    EXPECT_EQ(outcome.exit_code, 2) << command << "\n" << outcome.errors;
    EXPECT_THAT(outcome.errors, AllOf(HasSubstr("error"), HasSubstr(message))) << command;
    EXPECT_THAT(outcome.output, IsEmpty()) << command;
  }
  std::filesystem::remove_all(directory);
  std::filesystem::remove(self);
}

// Nothing that reads takes stack for every character.
TEST(Ends, LongArgumentsAreWrongInput) {
  const std::string spaces(100'000, ' '), brackets(100'000, '(');
  for (const std::string& sweep : {"seed" + spaces, "seed" + spaces + "=0,x", brackets}) {
    const Outcome outcome =
        RunProgram("saltus_sweep --contact=event --solver=none --progress=none --sweep='" + sweep + "'");
    EXPECT_EQ(outcome.exit_code, 2);
    EXPECT_THAT(outcome.errors, HasSubstr("error: "));
  }
}

TEST(Ends, PipesAreFiles) {
  const std::string scene = SourceFolder() + "/problems/two_balls.yaml", pipe = TempFile("pipe");
  ASSERT_EQ(mkfifo(pipe.c_str(), 0600), 0);
  const std::string program = BuildFolder() + "/bin/";
  EXPECT_EQ(RunCommand("(cat " + scene + " >" + pipe + " & " + program +
                       "saltus_audit --contact=event --progress=none --scene=" + pipe + ")")
                .exit_code,
            0);
  EXPECT_EQ(RunCommand("(printf 'steps\\n10\\n20\\n' >" + pipe + " & " + program +
                       "saltus_sweep --contact=event --solver=none --progress=none --sweep=@" + pipe +
                       SceneFlag("two_balls") + ")")
                .exit_code,
            0);
  std::filesystem::remove(pipe);
}

TEST(Ends, AGradientOfTheProgramsOwnIsTakenBack) {
  const std::string file = TempFile("given.json");
  const std::string audit = "saltus_audit --progress=none --json" + SceneFlag("two_balls") + "--contact=";
  const json document = json::parse(RunProgram(audit + "event,direct_toi,compliant_brax").output);
  const auto given = [&](const json& gradient) {
    std::ofstream(file) << gradient;
    const Outcome outcome = RunProgram(audit + "event --given=" + file);
    EXPECT_EQ(outcome.exit_code, 0) << outcome.errors;
    return json::parse(outcome.output)["given"];
  };
  const json right = given(document["audits"][0]["gradient"]);
  EXPECT_EQ(right["verdict"], "right");
  EXPECT_EQ(right["entries"].size(), 4u + 4u + 960u);
  EXPECT_EQ(given(document["reference"]["gradient"])["verdict"], "right");
  const json named = given(document["audits"][1]);
  EXPECT_EQ(named["name"], "direct_toi");
  EXPECT_NE(named["verdict"], "right");
  // Its control is held over two steps: so is the exact one then.
  const json halved = given(document["audits"][2]);
  ASSERT_EQ(halved["entries"].size(), 4u + 4u + 480u);
  json exact = document["reference"]["gradient"], coarse = json::array();
  for (size_t k = 0; k < 480; k += 2) {
    const json &a = exact["control"][k][0], &b = exact["control"][k + 1][0];
    coarse.push_back({{a[0].get<double>() + b[0].get<double>(), a[1].get<double>() + b[1].get<double>()}});
  }
  exact["control"] = coarse;
  exact["intervals"] = 240;
  EXPECT_EQ(given(exact)["verdict"], "right");
  exact.erase("intervals");
  EXPECT_NE(given(exact)["verdict"], "right");

  std::ofstream(file) << document;
  const Outcome whole = RunProgram(audit + "event --given=" + file);
  EXPECT_EQ(whole.exit_code, 2);
  EXPECT_THAT(whole.errors, HasSubstr("audits[0]"));
  exact["intervals"] = 7;
  std::ofstream(file) << exact;
  const Outcome uneven = RunProgram(audit + "event --given=" + file);
  EXPECT_EQ(uneven.exit_code, 2);
  EXPECT_THAT(uneven.errors, HasSubstr("a whole number that divides the 480 steps"));
  std::filesystem::remove(file);
}

// ---------------------------------------------------------------------------------------------------------------------
// Interrupts.

// A program at work, with what it prints in a file and its progress on a terminal, where it is shown ten times a
// second.
class DescribeRunningJobs {
 public:
  explicit DescribeRunningJobs(const std::string& command) {
    const winsize size = {.ws_row = 24, .ws_col = 200, .ws_xpixel = 0, .ws_ypixel = 0};
    int programs_end = -1;
    if (openpty(&terminal_, &programs_end, nullptr, nullptr, &size) != 0) return;
    process_ = fork();
    if (process_ == 0) {
      close(terminal_);
      dup2(programs_end, STDERR_FILENO);
      execl("/bin/sh", "sh", "-c", ("exec " + BuildFolder() + "/bin/" + command + " >" + output_).c_str(), nullptr);
      _exit(127);
    }
    close(programs_end);
  }
  ~DescribeRunningJobs() {
    if (!started()) return;
    kill(process_, SIGKILL);
    waitpid(process_, nullptr, 0);
    close(terminal_);
    std::filesystem::remove(output_);
  }

  // False where there are no terminals.
  bool started() const { return process_ > 0; }

  // Waits for it, for as long as that takes. False if the program ends without.
  bool Says(const std::string& text) {
    while (errors_.find(text) == std::string::npos) {
      if (!Hear()) return false;
    }
    return true;
  }

  // Waits until it has had so much time of a processor, and says something.
  bool Works(std::chrono::seconds time) {
    clockid_t clock = 0;
    timespec taken = {};
    while (clock_getcpuclockid(process_, &clock) == 0 && clock_gettime(clock, &taken) == 0 && Hear()) {
      if (std::chrono::seconds(taken.tv_sec) >= time) return true;
    }
    return false;
  }

  // Sends Ctrl-C, and waits for the end. A program that does not stop works for hours: what runs the tests ends it.
  Outcome Interrupt() {
    kill(process_, SIGINT);
    while (Hear()) continue;
    siginfo_t end = {};
    waitid(P_PID, static_cast<id_t>(process_), &end, WEXITED | WNOWAIT);
    return {end.si_code == CLD_EXITED ? end.si_status : -1, ContentsOf(output_), errors_};
  }

 private:
  // Waits for more, if there is more.
  bool Hear() {
    std::array<char, 4096> buffer;
    const ssize_t count = read(terminal_, buffer.data(), buffer.size());
    if (count > 0) errors_.append(buffer.data(), count);
    return count > 0;
  }

  std::string output_ = TempFile("output"), errors_;
  int terminal_ = -1;
  pid_t process_ = -1;
};

TEST(Interrupts, SolveKeepsWhatIsDoneAndWhatItWasAt) {
  DescribeRunningJobs program(
      "saltus_solve --contact=event --solver=ceres_event,gd --iterations=1000000000 --threads=1 --json" +
      SceneFlag("two_balls"));
  if (!program.started()) GTEST_SKIP() << "no terminals here";
  ASSERT_TRUE(program.Says("event gd"));  // at work, it says
  ASSERT_TRUE(program.Works(1s));         // of thousands of iterations
  const Outcome outcome = program.Interrupt();
  EXPECT_EQ(outcome.exit_code, 1);
  EXPECT_THAT(outcome.errors, HasSubstr("interrupted at event gd"));
  const json document = json::parse(outcome.output);
  EXPECT_EQ(document["interrupted"], true);
  ASSERT_EQ(document["runs"].size(), 2u);
  EXPECT_EQ(document["runs"][0]["termination"], "converged");
  const json& at_work = document["runs"][1];
  EXPECT_EQ(at_work["termination"], "interrupted");
  EXPECT_GT(at_work["losses"].size(), 1u);
  EXPECT_EQ(at_work["final_loss"], at_work["losses"].back());
  EXPECT_EQ(at_work["control"].size(), 480u);
}

// One gradient of this takes minutes.
std::string SlowScene() {
  const std::string path = TempFile("slow.yaml");
  const Outcome outcome = RunProgram("saltus_scene --kind=gas --discs=60 --seed=2 --steps=4000");
  EXPECT_EQ(outcome.exit_code, 0) << outcome.errors;
  std::ofstream(path) << outcome.output;
  return path;
}

TEST(Interrupts, AuditKeepsTheModelsThatAreDoneInTheMiddleOfAGradient) {
  const std::string scene = SlowScene();
  DescribeRunningJobs program("saltus_audit --contact=direct,ncp,convex --friction=0.1 --threads=1 --json --scene=" +
                              scene);
  if (!program.started()) GTEST_SKIP() << "no terminals here";
  ASSERT_TRUE(program.Says("ncp"));
  const Outcome outcome = program.Interrupt();
  EXPECT_EQ(outcome.exit_code, 1);
  EXPECT_THAT(outcome.errors, HasSubstr("interrupted at ncp"));
  const json document = json::parse(outcome.output);
  EXPECT_EQ(document["interrupted"], true);
  ASSERT_EQ(document["audits"].size(), 2u);  // the third had not begun
  EXPECT_EQ(document["audits"][0]["termination"], "not_applicable");
  EXPECT_EQ(document["audits"][1]["contact"], "ncp");
  EXPECT_EQ(document["audits"][1]["termination"], "interrupted");
  EXPECT_TRUE(document.contains("reference"));
  std::filesystem::remove(scene);
}

TEST(Interrupts, ProblemProgramsAndReproduceStopToo) {
  {
    DescribeRunningJobs program("two_balls --contact=event --solver=gd --iterations=1000000000");
    if (!program.started()) GTEST_SKIP() << "no terminals here";
    ASSERT_TRUE(program.Says("event gd"));
    const Outcome outcome = program.Interrupt();
    EXPECT_EQ(outcome.exit_code, 1);
    EXPECT_THAT(outcome.output, AllOf(HasSubstr("verdict"), HasSubstr("interrupted")));
  }
  const std::string directory = TempFile("report");
  DescribeRunningJobs program("saltus_reproduce --every_solver --threads=1 --output_dir=" + directory);
  if (!program.started()) GTEST_SKIP() << "no terminals here";
  ASSERT_TRUE(program.Says("comparison of solvers"));
  const Outcome outcome = program.Interrupt();
  EXPECT_EQ(outcome.exit_code, 1);
  EXPECT_THAT(outcome.errors, HasSubstr("interrupted"));
  std::filesystem::remove_all(directory);
}

}  // namespace
}  // namespace saltus
