// The programs as a user runs them: exit codes, JSON keys, CSV.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <fstream>
#include <nlohmann/json.hpp>
#include <sstream>
#include <string>
#include <vector>

#include "base/csv.h"
#include "folders.h"
#include "programs/run_program.h"
#include "reference_values.h"

namespace saltus {
namespace {

using nlohmann::json;
using testing::Contains;
using testing::ContainsRegex;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::Not;

TEST(CommandLine, TwoBallsByGradientDescent) {
  const Outcome outcome = RunProgram("two_balls --contact=direct_toi --solver=gd --json --progress=none");
  ASSERT_EQ(outcome.exit_code, 1) << outcome.errors;  // so many iterations, and no convergence
  const json document = json::parse(outcome.output);
  const json& run = document["solve"]["runs"][0];
  EXPECT_EQ(run["contact"], "direct_toi");
  EXPECT_EQ(run["solver"], "gd");
  ASSERT_EQ(run["losses"].size(), 1001u);
  EXPECT_NEAR(run["losses"][999], 1.395810606, 1e-7);
  EXPECT_EQ(run["losses"][0], run["initial_loss"]);
  EXPECT_EQ(run["losses"][1000], run["final_loss"]);
  EXPECT_EQ(run["termination"], "iteration_limit");
  EXPECT_EQ(run["control"].size(), 480u);
  EXPECT_EQ(run["velocity"].size(), 2u);
  const json& gradient = document["audit"]["audits"][0]["gradient"];
  EXPECT_NEAR(gradient["position"][0][0], -0.719080, 1e-6);
  EXPECT_EQ(gradient["control"].size(), 480u);
  EXPECT_TRUE(gradient["parameters"].contains("restitution"));
}

// Every launch that hits the target; values by an independent search (data/exact_references.json).
TEST(CommandLine, GroundWallListsEveryLaunchThatHits) {
  const json& reference = ReferenceFile("exact_references.json").at("task2");
  const std::pair<const char*, const char*> cases[] = {{"0", "minima_frictionless"}, {"0.1", "minima_mu0.1"}};
  for (const auto& [friction, key] : cases) {
    const Outcome outcome = RunProgram(std::string("ground_wall --contact=event --solver=ceres_lm --json ") +
                                       "--progress=none --friction=" + friction);
    ASSERT_EQ(outcome.exit_code, 0) << outcome.errors;
    const json document = json::parse(outcome.output);
    ASSERT_EQ(document["launches"].size(), reference[key].size());
    double speed_squared = 0;
    for (const json& launch : document["launches"]) {
      std::string branch;
      for (const json& event : launch["events"]) branch += (branch.empty() ? "" : "+") + event["b"].get<std::string>();
      const json& expected = reference.at(key).at(branch.empty() ? "none" : branch);
      for (int j = 0; j < 2; ++j) {
        EXPECT_NEAR(launch["velocity"][j].get<double>(), Number(expected[j]), 1e-9) << branch;
      }
      EXPECT_EQ(launch["minimum_effort"], branch.empty()) << branch;
      EXPECT_GT(launch["speed_squared"], speed_squared);
      speed_squared = launch["speed_squared"];
    }
    const json& run = document["solve"]["runs"][0];
    EXPECT_LT(run["final_loss"], 1e-20);
    EXPECT_LE(run["iterations"], 15);
  }
}

TEST(CommandLine, AnySteps) {
  const Outcome outcome =
      RunProgram("two_balls --contact=direct_toi --solver=none --steps=1000 --json --progress=none");
  ASSERT_EQ(outcome.exit_code, 0) << outcome.errors;
  EXPECT_EQ(json::parse(outcome.output)["audit"]["audits"][0]["gradient"]["control"].size(), 1000u);
}

TEST(CommandLine, StiffnessSweepGivesThePublishedCurve) {
  const Outcome outcome =
      RunProgram("saltus_sweep" + SceneFlag("two_balls") +
                 "--contact=compliant_warp --solver=gd --sweep='stiffness=1e2:1e5:log:4' --progress=none");
  ASSERT_EQ(outcome.exit_code, 0) << outcome.errors;
  const StatusOr<CsvDocument> csv = ParseCsv(outcome.output);
  ASSERT_TRUE(csv.ok());
  ASSERT_EQ(csv->rows.size(), 4u);
  // The fourth, 1e5 N/m, fails to learn and ends where rounding leaves it.
  const std::array<double, 3> expected = {1.76746, 1.49850, 1.66228};
  for (size_t i = 0; i < expected.size(); ++i) {
    EXPECT_NEAR(std::stod(csv->rows[i][*csv->Find("loss_before_last")]), expected[i], 1e-4);
  }
  EXPECT_GT(std::stod(csv->rows[3][*csv->Find("loss_before_last")]), 1.6);
}

TEST(CommandLine, AFailedPointIsARowWithItsReason) {
  const Outcome outcome =
      RunProgram("saltus_sweep" + SceneFlag("two_balls") +
                 "--contact=direct --solver=gd --iterations=2 --sweep='restitution=0.5,1.5;friction=0,0.1' "
                 "--progress=none");
  ASSERT_EQ(outcome.exit_code, 0) << outcome.errors;
  const StatusOr<CsvDocument> csv = ParseCsv(outcome.output);
  ASSERT_TRUE(csv.ok());
  ASSERT_EQ(csv->rows.size(), 4u);
  const size_t termination = *csv->Find("termination"), reason = *csv->Find("reason");
  EXPECT_EQ(csv->rows[0][termination], "iteration_limit");
  EXPECT_EQ(csv->rows[1][termination], "not_applicable");
  EXPECT_THAT(csv->rows[1][reason], HasSubstr("friction"));
  EXPECT_EQ(csv->rows[2][termination], "failed");
  EXPECT_THAT(csv->rows[2][reason], HasSubstr("restitution"));
}

TEST(CommandLine, WrongInputIsExitCodeTwoAndNamesThePlace) {
  const std::string bad = TempFileWith("bad.yaml",
                                       "name: bad\nduration: 1\nsteps: 10\nobjective: {terminal: []}\noptimize: none\n"
                                       "bodies:\n  - {name: a, radius: -1, mass: 1, position: [0, 0]}\n");
  const struct {
    std::string command, message;
  } cases[] = {
      {"saltus_audit --scene=" + bad, "bodies[0].radius"},
      {"saltus_audit --scene=/nonexistent.yaml", "nonexistent"},
      {"saltus_audit", "--scene"},
      {"saltus_audit --no_such_flag=1", "no_such_flag"},
      {"saltus_audit --steps=many" + SceneFlag("two_balls"), "steps"},
      {"saltus_audit --steps=-3" + SceneFlag("two_balls"), "steps"},
      {"saltus_audit --restitution=2" + SceneFlag("two_balls"), "restitution"},
      {"saltus_audit --contact=direct_tio" + SceneFlag("two_balls"), "direct_tio"},
      {"saltus_audit --contact=direct --friction=0.1" + SceneFlag("two_balls"), "friction"},
      {"saltus_audit --precision=half" + SceneFlag("two_balls"), "precision"},
      {"saltus_audit stray" + SceneFlag("two_balls"), "stray"},
      {"saltus_solve --solver=ceres_lm --contact=direct" + SceneFlag("bounce_once"), "ceres_lm"},
      {"bounce_once --solver=hmp,gd --contact=event", "nothing to optimize"},
      {"saltus_solve --solver=newton" + SceneFlag("two_balls"), "newton"},
      {"saltus_audit --surrogate=smooth" + SceneFlag("two_balls"),
       "complementarity_aware, smoothed_zeroth, smoothed_first"},
      {"saltus_audit --surrogate=smoothed_first --surrogate_sigma=0" + SceneFlag("two_balls"), "--surrogate_sigma"},
      {"saltus_audit --surrogate=smoothed_first --surrogate_samples=7" + SceneFlag("two_balls"), "--surrogate_samples"},
      {"saltus_solve --surrogate=smoothed_zeroth --surrogate_samples=0" + SceneFlag("two_balls"),
       "--surrogate_samples"},
      {"saltus_solve --surrogate_segments=24" + SceneFlag("two_balls"), "--surrogate_segments"},
      {"saltus_audit --surrogate=smoothed_first --width_sweep" + SceneFlag("two_balls"), "width_sweep"},
      {"saltus_audit --surrogate=complementarity_aware --contact=direct" + SceneFlag("two_balls"), "complementarity"},
      {"saltus_solve --surrogate=smoothed_zeroth --contact=event --solver=hmp" + SceneFlag("two_balls"), "surrogate"},
      {"saltus_reproduce --surrogate=smoothed_zeroth", "--surrogate"},
      {"saltus_solve --warm_start=" + SceneFlag("two_balls"), "--warm_start is empty"},
      {"saltus_solve --contact=" + SceneFlag("two_balls"), "--contact is empty"},
      {"saltus_sweep --sweep=stiffness" + SceneFlag("two_balls"), "stiffness"},
      {"saltus_sweep --sweep=colour=1,2" + SceneFlag("two_balls"), "colour"},
      {"saltus_sweep --sweep=stiffness=-1:1:log:3" + SceneFlag("two_balls"), "logarithmic"},
  };
  for (const auto& [command, message] : cases) {
    const Outcome outcome = RunProgram(command);
    EXPECT_EQ(outcome.exit_code, 2) << command << "\n" << outcome.errors;
    EXPECT_THAT(outcome.errors, HasSubstr(message)) << command;
  }
}

TEST(CommandLine, NamesThatAreGivenTwiceCountOnce) {
  const Outcome outcome = RunProgram(
      "saltus_solve --contact=event,direct_toi,event --solver=gd,gd --iterations=1 --json" + SceneFlag("two_balls"));
  const json document = json::parse(outcome.output);
  ASSERT_EQ(document["runs"].size(), 2u) << outcome.output;
  EXPECT_EQ(document["runs"][0]["contact"], "event");
  EXPECT_EQ(document["runs"][1]["contact"], "direct_toi");
}

TEST(CommandLine, ListsAndHelpAreNoErrors) {
  EXPECT_THAT(RunProgram("saltus_solve --contact=list").output, HasSubstr("direct_toi"));
  EXPECT_EQ(RunProgram("saltus_solve --contact=list").exit_code, 0);
  EXPECT_THAT(RunProgram("saltus_solve --solver=list").output, HasSubstr("gd"));
  EXPECT_THAT(RunProgram("saltus_solve --surrogate=list").output, HasSubstr("smoothed_first"));
  EXPECT_EQ(RunProgram("saltus_solve --help").exit_code, 0);
}

// The program's own flags, and what they default to; --helpfull has the rest.
TEST(CommandLine, HelpHasTheOwnFlagsOnly) {
  const struct {
    std::string program;
    std::vector<std::string> has, has_not;
  } cases[] = {
      {"two_balls", {"--scene=FILE", "--solver=LIST", "--width_sweep"}, {"--given", "--sweep", "--discs"}},
      {"saltus_audit", {"--scene=FILE", "--given=FILE", "--surrogate=NAME"}, {"--solver", "--iterations", "--sweep"}},
      {"saltus_solve", {"--scene=FILE", "--solver=LIST", "--memory_limit=MIB"}, {"--given", "--width_sweep"}},
      {"saltus_sweep", {"--sweep=POINTS", "--shard=I/N", "--iterations=N"}, {"--given", "--discs"}},
      {"saltus_scene",
       {"--kind=NAME", "--discs=N", "(default: 100)"},
       {"--scene=", "--contact", "--json", "--threads"}},
      {"saltus_reproduce", {"--[no]all_formulations", "--output_dir=DIR"}, {"--scene", "--contact", "--json"}},
  };
  for (const auto& [program, has, has_not] : cases) {
    const Outcome help = RunProgram(program + " --help");
    EXPECT_EQ(help.exit_code, 0) << help.errors;
    EXPECT_EQ(help.output.substr(0, program.size() + 1), program + ":");
    for (const std::string& flag : has) EXPECT_THAT(help.output, HasSubstr(flag)) << program;
    for (const std::string& flag : has_not) EXPECT_THAT(help.output, Not(HasSubstr(flag))) << program;
    for (const char* flag : {"logtostderr", "tab_completion", "minloglevel"}) {
      EXPECT_THAT(help.output, Not(HasSubstr(flag))) << program;
      EXPECT_THAT(RunProgram(program + " --helpfull").output, HasSubstr(flag)) << program;
    }
    for (const char* alias : {" -h", " --h", " -help", " --helpshort"}) {
      EXPECT_EQ(RunProgram(program + alias).output, help.output) << alias;
    }
    EXPECT_LT(std::count(help.output.begin(), help.output.end(), '\n'), 100) << program;
    std::stringstream narrow(RunProgramIn(60, program + " -h").output);
    for (std::string line; std::getline(narrow, line);) EXPECT_LE(line.size(), 60u) << line;
  }
}

TEST(CommandLine, MoreThreadsThanCoresAreNoMatterOfNote) {
  const Outcome outcome = RunProgram(
      "saltus_audit --contact=event --surrogate=smoothed_first --surrogate_samples=20 --threads=1000 "
      "--progress=none" +
      SceneFlag("bounce_once"));
  EXPECT_EQ(outcome.exit_code, 0);
  EXPECT_EQ(outcome.errors, "");
}

TEST(CommandLine, SimulatorsAreThoseOfFlagFilesAndOfTheCommandLine) {
  const std::string file = TempFileWith("simulators", "--simulate=a=false\n--simulate=b=false\n");
  const Outcome outcome = RunProgram("saltus_audit --json --progress=none --flagfile=" + file +
                                     " --simulate c=false -simulate=d=false" + SceneFlag("bounce_once"));
  EXPECT_EQ(outcome.exit_code, 1) << outcome.errors;
  std::vector<std::string> names;
  const json document = json::parse(outcome.output);
  for (const json& audit : document["audits"]) names.push_back(audit["contact"]);
  EXPECT_THAT(names, ElementsAre("a", "b", "c", "d"));
}

// A flag that would be ignored is an error that names who takes it, however it was given.
TEST(CommandLine, FlagsOfOtherProgramsAreRefused) {
  const std::string file = TempFileWith("flags", "--iterations=5\n");
  const struct {
    std::string command, message;
  } cases[] = {
      {"saltus_audit --iterations=5" + SceneFlag("two_balls"),
       "--iterations is not a flag of saltus_audit, but of the problems' programs, the programs of hybrid systems, "
       "saltus_bodies, saltus_solve and saltus_sweep"},
      {"saltus_audit --flagfile=" + file + SceneFlag("two_balls"), "--iterations is not a flag of saltus_audit"},
      {"saltus_solve --given=x.json" + SceneFlag("two_balls"),
       "--given is not a flag of saltus_solve, but of saltus_audit"},
      {"saltus_solve -sweep steps=1,2" + SceneFlag("two_balls"),
       "--sweep is not a flag of saltus_solve, but of saltus_sweep"},
      {"saltus_scene --json", "--json is not a flag of saltus_scene"},
      {"saltus_scene --nojson", "--json is not a flag of saltus_scene"},
      {"saltus_reproduce --scene=x.yaml", "--scene is not a flag of saltus_reproduce"},
      {"two_balls --given=x.json", "--given is not a flag of two_balls, but of saltus_audit"},
      {"saltus_solve --itertions=5", "--itertions is not a flag of saltus_solve; did you mean --iterations?"},
      {"saltus_solve --no_such_flag", "--no_such_flag is not a flag of saltus_solve; -h lists them"},
      {"saltus_solve --contact=direct_tio" + SceneFlag("two_balls"), "did you mean direct_toi?"},
      {"saltus_solve --solver=ceres_llm" + SceneFlag("two_balls"), "did you mean ceres_lm?"},
      {"saltus_solve", "--scene=FILE is needed; -h lists all flags"},
  };
  for (const auto& [command, message] : cases) {
    const Outcome outcome = RunProgram(command);
    EXPECT_EQ(outcome.exit_code, 2) << command;
    EXPECT_THAT(outcome.errors, HasSubstr(message)) << command;
    EXPECT_EQ(std::count(outcome.errors.begin(), outcome.errors.end(), '\n'), 1) << outcome.errors;
  }
  // Flags of glog, with and without values, and those that --undefok lets pass.
  for (const char* flags : {" --minloglevel=2", " --steps 20", " --undefok=unheard --unheard"}) {
    const Outcome outcome = RunProgram("saltus_audit --contact=event --progress=none" + SceneFlag("two_balls") + flags);
    EXPECT_EQ(outcome.exit_code, 0) << flags << outcome.errors;
  }
}

TEST(CommandLine, AModelThatCannotTakeTheSceneIsARowBesideOthers) {
  const Outcome outcome = RunProgram("saltus_audit --contact=direct,convex --friction=0.1 --json --progress=none" +
                                     SceneFlag("ground_wall"));
  ASSERT_EQ(outcome.exit_code, 0) << outcome.errors;
  const json audits = json::parse(outcome.output)["audits"];
  ASSERT_EQ(audits.size(), 2u);
  for (const json& audit : audits) {
    EXPECT_EQ(audit.contains("reason"), audit["contact"] == "direct");
  }
}

TEST(CommandLine, EveryOutputOfASurrogateSaysThatItIsBiased) {
  const std::string dir = TempFile("surrogate");
  const std::string flags =
      " --surrogate=smoothed_zeroth --surrogate_samples=200 --surrogate_segments=24 "
      "--surrogate_sigma=0.1 --progress=none --contact=direct" +
      SceneFlag("two_balls") + "--output_dir=" + dir;
  const Outcome both = RunProgram("two_balls --json --solver=gd --iterations=3" + flags);
  ASSERT_EQ(both.exit_code, 1) << both.errors;  // no convergence
  const json document = json::parse(both.output);
  const json &audit = document["audit"]["audits"][0], &run = document["solve"]["runs"][0];
  for (const json& item : {audit, run}) {
    EXPECT_EQ(item["surrogate"], "smoothed_zeroth");
    EXPECT_EQ(item["biased"], true);
    EXPECT_EQ(item["smoothing"], json({{"sigma", 0.1}, {"samples", 200}, {"seed", 1}, {"segments", 24}}));
  }
  EXPECT_EQ(audit["verdict"], "biased");
  EXPECT_TRUE(audit["gradient"]["parameters"].is_null());
  EXPECT_GT(audit["standard_error"]["velocity"][1][0], 0);
  EXPECT_EQ(audit["standard_error"]["control"].size(), 480u);
  EXPECT_LT(audit["error_in_standard_errors"], 2);
  EXPECT_EQ(run["standard_error"].size(), 960u);
  EXPECT_EQ(run["evaluations"], 3);

  const Outcome tables = RunProgramIn(1000, "saltus_audit" + flags);
  EXPECT_THAT(tables.output, HasSubstr("surrogate of the gradient (smoothed_zeroth, biased)"));
  EXPECT_THAT(tables.output, HasSubstr("direct (smoothed_zeroth, biased)"));
  EXPECT_THAT(tables.output, HasSubstr("standard errors from the exact gradient"));
  const StatusOr<CsvDocument> csv = ReadCsv(dir + "/two_balls_smoothed_zeroth_biased_gradients.csv");
  ASSERT_TRUE(csv.ok()) << csv.status().message();
  ASSERT_EQ(csv->rows.size(), 4 + 4 + 960u);
  for (const std::vector<std::string>& row : csv->rows) EXPECT_EQ(row[*csv->Find("biased")], "yes");
  EXPECT_NEAR(std::stod(csv->rows[0][*csv->Find("exact")]), -0.39866841646141652, 1e-12);
  EXPECT_GT(std::stod(csv->rows[0][*csv->Find("standard error")]), 0);

  EXPECT_THAT(RunProgram("saltus_solve --iterations=1" + flags).output, HasSubstr("direct (smoothed_zeroth, biased)"));
  EXPECT_TRUE(std::ifstream(dir + "/two_balls_direct_gd_smoothed_zeroth_biased.npz").good());

  const Outcome option = RunProgramIn(
      1000,
      "saltus_solve --iterations=1 --progress=none --contact=lcp:complementarity_aware=1" + SceneFlag("two_balls"));
  EXPECT_THAT(option.output, HasSubstr("lcp:complementarity_aware=1 (biased)"));

  const Outcome options =
      RunProgram("saltus_sweep --solver=none --progress=none --sweep='contact=lcp,lcp:complementarity_aware=1'" +
                 SceneFlag("two_balls"));
  const StatusOr<CsvDocument> contacts = ParseCsv(options.output);
  ASSERT_TRUE(contacts.ok() && contacts->Find("biased")) << options.output << options.errors;
  EXPECT_EQ(contacts->rows[0][*contacts->Find("biased")], "no");
  EXPECT_EQ(contacts->rows[1][*contacts->Find("biased")], "yes");

  const Outcome sweep = RunProgram(
      "saltus_sweep --solver=none --sweep='surrogate_samples=4,400' --surrogate=smoothed_first "
      "--progress=none --contact=event" +
      SceneFlag("two_balls"));
  ASSERT_EQ(sweep.exit_code, 0) << sweep.errors;
  const StatusOr<CsvDocument> points = ParseCsv(sweep.output);
  ASSERT_TRUE(points.ok()) << points.status().message();
  ASSERT_EQ(points->rows.size(), 2u);
  for (const std::vector<std::string>& row : points->rows) {
    EXPECT_EQ(row[*points->Find("surrogate")], "smoothed_first");
    EXPECT_EQ(row[*points->Find("biased")], "yes");
    EXPECT_LT(std::stod(row[*points->Find("relative_error")]), 0.1);
    EXPECT_GT(std::stod(row[*points->Find("norm_standard_error")]), 0);
  }
}

const json& AuditOf(const json& document, const std::string& contact) {
  for (const json& audit : document["audits"]) {
    if (audit["contact"] == contact) return audit;
  }
  static const json none;
  ADD_FAILURE() << "no audit of " << contact;
  return none;
}

TEST(CommandLine, TheAuditTellsRightFromWrongAndWhereAndWhy) {
  const Outcome outcome = RunProgram("saltus_audit --contact=direct_toi,toi_velocity,event --json --progress=none" +
                                     SceneFlag("two_balls"));
  ASSERT_EQ(outcome.exit_code, 0) << outcome.errors;
  const json document = json::parse(outcome.output);
  EXPECT_EQ(document["reference"]["contact"], "event");
  // Not -0.0009, as published.
  EXPECT_NEAR(document["reference"]["gradient"]["control"][0][0][0], 0.00021380129632184102, 1e-14);
  const json& direct_toi = AuditOf(document, "direct_toi");
  EXPECT_EQ(direct_toi["verdict"], "wrong");
  EXPECT_EQ(direct_toi["first_wrong_step"], 331);
  EXPECT_EQ(direct_toi["class"], "impact time resolved");
  EXPECT_NEAR(direct_toi["class_evidence"]["position_from_position"], -1, 1e-3);
  EXPECT_EQ(direct_toi["first_wrong_contact"], json({"striker", "target"}));
  EXPECT_EQ(direct_toi["block"], "velocity from position");
  EXPECT_EQ(direct_toi["why"], "acceleration at the impact ignored");
  const json& position = direct_toi["refinement"]["quantities"][0];
  EXPECT_GE(position["error"].size(), 4u);
  EXPECT_NEAR(position["converges_to"][0], -0.7199, 1e-3);
  EXPECT_NEAR(position["converges_to"][2], 0, 1e-9);
  EXPECT_EQ(AuditOf(document, "toi_velocity")["verdict"], "consistent");
  EXPECT_FALSE(AuditOf(document, "toi_velocity").contains("first_wrong_step"));
  EXPECT_EQ(AuditOf(document, "event")["verdict"], "right");
}

TEST(CommandLine, TheAuditWritesTablesAndFigures) {
  const std::string dir = TempFile("audit");
  const Outcome outcome =
      RunProgramIn(1000,
                   "saltus_audit --contact=direct_toi,toi_velocity --width_sweep --progress=none --output_dir=" + dir +
                       SceneFlag("two_balls"));
  ASSERT_EQ(outcome.exit_code, 0) << outcome.errors;
  EXPECT_THAT(outcome.output, HasSubstr("acceleration at the impact ignored"));
  EXPECT_THAT(outcome.output, HasSubstr("agrees with narrow differences, not with wide ones"));
  EXPECT_EQ(outcome.output.find('\033'), std::string::npos) << "colour in a pipe";
  const StatusOr<CsvDocument> refinement = ReadCsv(dir + "/two_balls_refinement.csv");
  ASSERT_TRUE(refinement.ok()) << refinement.status().message();
  EXPECT_GE(refinement->rows.size(), 2u * 3 * 4);
  const StatusOr<CsvDocument> entries = ReadCsv(dir + "/two_balls_gradients.csv");
  ASSERT_TRUE(entries.ok()) << entries.status().message();
  const std::vector<std::string>& first = entries->rows[0];
  EXPECT_EQ(first[*entries->Find("entry")], "px striker");
  EXPECT_NEAR(std::stod(first[*entries->Find("exact")]), -0.39866841646141652, 1e-12);
  EXPECT_NEAR(std::stod(first[*entries->Find("own steps")]), -0.719080, 1e-6);
  EXPECT_TRUE(ReadCsv(dir + "/two_balls_contacts.csv").ok());
  EXPECT_TRUE(ReadCsv(dir + "/two_balls_classes.csv").ok());
  for (const char* name : {"widths.csv", "verdicts.md"}) {
    EXPECT_TRUE(std::ifstream(dir + "/two_balls_" + name).good()) << name;
  }
}

// Solvers that know exact contact only are one row, whatever other models are asked for.
TEST(CommandLine, EventAlignedSolutionsHaveDurationsAndACertificate) {
  const Outcome outcome =
      RunProgram("saltus_solve" + SceneFlag("two_balls") + "--solver=ceres_event,hmp --json --progress=none");
  ASSERT_EQ(outcome.exit_code, 0) << outcome.errors;
  const json runs = json::parse(outcome.output)["runs"];
  ASSERT_EQ(runs.size(), 2u);
  for (const json& run : runs) {
    EXPECT_EQ(run["contact"], "event");
    EXPECT_EQ(run["termination"], "converged");
    EXPECT_NEAR(run["exact_loss"], 1.396542160123197, 1e-6);
    ASSERT_EQ(run["durations"].size(), 480u);
    EXPECT_EQ(run["control"].size(), 480u);
    double sum = 0;
    for (const double duration : run["durations"]) sum += duration;
    EXPECT_NEAR(sum, 1, 1e-12);
    EXPECT_EQ(run["certificate"]["verdict"], "stationary");
    EXPECT_EQ(run["certificate"]["scope"], "local");
    EXPECT_EQ(run["certificate"]["impacts"].size(), 1u);
    EXPECT_EQ(run["certificate"]["curvature"]["kind"], "minimum");
    EXPECT_GT(run["certificate"]["curvature"]["smallest"], 0.5);
    EXPECT_EQ(run["certificate"]["curvature"]["direction"].size(), 480u);
  }
}

// The loss that a solver has converged on is named beside the verdict, which is about the exact loss.
TEST(CommandLine, ConvergedSaysOnWhichLoss) {
  const std::string solve = "saltus_solve" + SceneFlag("two_balls") +
                            "--contact=convex_toi,event --solver=ceres_lm,grid_optimum --progress=none";
  const Outcome table = RunProgramIn(1000, solve);
  EXPECT_THAT(table.output, HasSubstr("exact loss is at"));
  EXPECT_THAT(table.output, HasSubstr("converged under convex_toi"));
  EXPECT_THAT(table.output, HasSubstr("not stationary"));
  EXPECT_THAT(table.output, HasSubstr("minimum on the grid"));
  int converged = 0;
  const json document = json::parse(RunProgram(solve + " --json").output);
  for (const json& run : document["runs"]) {
    EXPECT_EQ(run["certificate"]["of"], "exact_loss");
    EXPECT_EQ(run.contains("converged_under"), run["termination"] == "converged");
    if (run["termination"] != "converged") continue;
    ++converged;
    EXPECT_EQ(run["converged_under"], run["contact"]);
    if (run["contact"] == "event") {
      EXPECT_EQ(run["certificate"]["verdict"], "stationary_on_grid");
    }
  }
  EXPECT_EQ(converged, 2);
}

// Lines of a text, each without the spaces that align it.
std::vector<std::string> WordsByLine(const std::string& text) {
  std::vector<std::string> lines;
  std::stringstream stream(text);
  for (std::string line; std::getline(stream, line);) {
    std::stringstream words(line);
    std::string joined;
    for (std::string word; words >> word;) joined += (joined.empty() ? "" : " ") + word;
    lines.push_back(joined);
  }
  return lines;
}

TEST(CommandLine, CertificatesAreInTheTextInWords) {
  const Outcome outcome =
      RunProgramIn(400, "two_balls --contact=event,direct_toi --solver=hmp,gd --iterations=20 --progress=none");
  EXPECT_EQ(outcome.exit_code, 1) << outcome.errors;  // gd does not converge
  const std::vector<std::string> lines = WordsByLine(outcome.output);
  EXPECT_THAT(outcome.output, HasSubstr("stationary with a residual of at most 1e-06"));
  EXPECT_THAT(lines, Contains("contact solver exact loss is at residual smallest curvature what it means"));
  EXPECT_THAT(lines,
              Contains(ContainsRegex("^event hmp minimum [0-9.e-]+ 0.97[0-9] no small change of the control lowers the "
                                     "loss; other sequences of impacts may be better$")));
  EXPECT_THAT(lines,
              Contains(ContainsRegex("^direct_toi gd not stationary 0.[0-9]+ small changes of the control lower the "
                                     "loss: the largest residual is that of .*$")));

  const Outcome searched =
      RunProgramIn(400, "saltus_solve --contact=event --solver=mode_search --progress=none" + SceneFlag("two_balls"));
  EXPECT_THAT(searched.output, HasSubstr("it is the best of 3 sequences of impacts"));

  const Outcome velocity = RunProgramIn(400, "ground_wall --contact=event --solver=ceres_lm --progress=none");
  EXPECT_THAT(velocity.output, Not(HasSubstr("certificate"))) << "of controls only";
}

// Whatever the terminal, lines fit it and no word is lost.
TEST(CommandLine, TablesFitTheTerminal) {
  const std::string command = "two_balls --solver=ceres_lbfgs --contact=event,direct,lcp --progress=none";
  const auto longest = [](const std::string& text) {
    size_t columns = 0;
    std::stringstream stream(text);
    for (std::string line; std::getline(stream, line);) columns = std::max(columns, line.size());
    return columns;
  };
  const std::string wide = RunProgramIn(1000, command).output;
  EXPECT_GT(longest(wide), 200u);
  EXPECT_THAT(wide, HasSubstr("d/dux[0] striker  d/duy[0] striker"));
  EXPECT_LE(longest(RunProgram(command).output), 100u) << "in a pipe";
  for (const int columns : {60, 80, 132}) {
    const std::string text = RunProgramIn(columns, command).output;
    EXPECT_LE(longest(text), columns);
    std::stringstream words(wide);
    for (std::string word; words >> word;) {
      // Rules and seconds are not the same twice.
      if (word.find_first_not_of("-0123456789.e") == std::string::npos) continue;
      EXPECT_THAT(text, HasSubstr(word)) << columns;
    }
  }
}

// Position and velocity of 20 discs, and the first force on one: rows, not columns.
TEST(CommandLine, AGradientOfManyDiscsHasARowAnEntry) {
  const std::string scene = TempFile("gas.yaml");
  ASSERT_EQ(RunProgram("saltus_scene --discs=20 --steps=20 >" + scene).exit_code, 0);
  const Outcome outcome = RunProgram("saltus_audit --contact=event --progress=none --scene=" + scene);
  ASSERT_EQ(outcome.exit_code, 0) << outcome.errors;
  const std::vector<std::string> lines = WordsByLine(outcome.output);
  const auto entries =
      std::count_if(lines.begin(), lines.end(), [](const std::string& line) { return line.substr(0, 3) == "d/d"; });
  EXPECT_EQ(entries, 4 * 20 + 2);
}

TEST(CommandLine, SequencesAreReadFromAFlag) {
  const std::string solve =
      "saltus_solve" + SceneFlag("multiple_collisions") + "--contact=event --json --progress=none ";
  const Outcome given = RunProgram(solve + "--solver=mode_search --sequence=striker-target,target-ceiling");
  ASSERT_EQ(given.exit_code, 0) << given.errors;
  const json run = json::parse(given.output)["runs"][0];
  EXPECT_NEAR(run["exact_loss"], 0.3736363502, 1e-6);
  EXPECT_EQ(run["optima"].size(), 1u);
  EXPECT_EQ(run["optima"][0]["sequence"][1]["b"], "ceiling");

  const Outcome wrong = RunProgram(solve + "--solver=ceres_event --sequence=striker-floor");
  EXPECT_EQ(wrong.exit_code, 2);
  EXPECT_THAT(wrong.errors, HasSubstr("striker-floor"));
  EXPECT_THAT(wrong.errors, HasSubstr("target-ceiling"));

  const Outcome refused = RunProgram(solve + "--solver=hmp --sequence=none");
  EXPECT_EQ(refused.exit_code, 2);
  EXPECT_THAT(refused.errors, HasSubstr("no contact in the sequence"));
}

// The published table of task 3 has four decimals of a gradient by hand. Its last column is of another loss.
TEST(CommandLine, TheAuditFindsTheErrorInThePublishedAnalyticGradient) {
  const std::string file = TempFile("published.json");
  std::ofstream(file) << R"({"name": "published", "tolerance": 5.1e-5,
                             "position": [[-0.3987, -0.3987], [-0.3213, null]], "control": [[[-0.0009, -0.0009]]]})";
  const std::string command =
      "saltus_audit --contact=event --progress=none" + SceneFlag("two_balls") + "--given=" + file;
  Outcome outcome = RunProgram(command + " --json");
  EXPECT_EQ(outcome.exit_code, 2) << "a vector is [x, y] or null";
  EXPECT_THAT(outcome.errors, HasSubstr("position[1]"));

  std::ofstream(file) << R"({"name": "published", "tolerance": 5.1e-5,
                             "position": [[-0.3987, -0.3987], [-0.3213, -0.3213]],
                             "velocity": [null, [-0.2221, -0.2221]], "control": [[[-0.0009, -0.0009]]]})";
  outcome = RunProgram(command + " --json");
  ASSERT_EQ(outcome.exit_code, 0) << outcome.errors;
  const json given = json::parse(outcome.output)["given"];
  EXPECT_EQ(given["verdict"], "wrong sign");
  ASSERT_EQ(given["entries"].size(), 8u);
  for (const json& entry : given["entries"]) {
    const bool is_control = entry["entry"].get<std::string>()[0] == 'u';
    EXPECT_EQ(entry["verdict"], is_control ? "wrong sign" : "right") << entry;
  }
  EXPECT_NEAR(given["entries"][6]["exact"], 0.00021380129632184102, 1e-14);
  EXPECT_THAT(RunProgram(command).output, HasSubstr("published: wrong sign"));
}

}  // namespace
}  // namespace saltus
