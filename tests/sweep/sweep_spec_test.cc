#include <gflags/gflags.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>

#include "folders.h"
#include "saltus/scene/materials.h"
#include "sweep/study.h"

namespace saltus {
namespace {

using testing::AllOf;
using testing::ElementsAre;
using testing::HasSubstr;

Scene TwoBalls() { return LoadScene(SourceFolder() + "/problems/two_balls.yaml"); }

SweepRow Numbers(std::initializer_list<double> numbers) { return SweepRow(numbers.begin(), numbers.end()); }

std::vector<double> Column(const SweepBlock& block, size_t column) {
  std::vector<double> values;
  for (const SweepRow& row : block.rows) values.push_back(ToNumber(row[column]));
  return values;
}

TEST(SweepSpec, ListsAndRanges) {
  const std::vector<SweepBlock> blocks =
      ParseSweep(" stiffness = 1e2:1e5:log:4 ; damping=0,2.5:3:lin:3,+7 ;steps=10:1000:log:3", TwoBalls());
  ASSERT_EQ(blocks.size(), 3u);
  EXPECT_THAT(blocks[0].options, ElementsAre("stiffness"));
  EXPECT_THAT(Column(blocks[0], 0), ElementsAre(1e2, 1e3, 1e4, 1e5));
  EXPECT_THAT(Column(blocks[1], 0), ElementsAre(0, 2.5, 2.75, 3, 7));
  EXPECT_THAT(Column(blocks[2], 0), ElementsAre(10, 100, 1000));
}

TEST(SweepSpec, RangesOfWholeNumbersAreRounded) {
  EXPECT_THAT(Column(ParseSweep("steps=10:20:lin:4", TwoBalls())[0], 0), ElementsAre(10, 13, 17, 20));
}

TEST(SweepSpec, ZippedOptionsMoveTogether) {
  const std::vector<SweepBlock> blocks = ParseSweep("stiffness=1,2&damping=3,4 & striker.mass=5,6", TwoBalls());
  ASSERT_EQ(blocks.size(), 1u);
  EXPECT_THAT(blocks[0].options, ElementsAre("stiffness", "damping", "striker.mass"));
  EXPECT_THAT(blocks[0].rows, ElementsAre(Numbers({1, 3, 5}), Numbers({2, 4, 6})));
}

TEST(SweepSpec, ExplicitPointsInline) {
  const std::vector<SweepBlock> blocks =
      ParseSweep("(contact, learning_rate)=(direct_toi, 10),(event,5); friction=0", TwoBalls());
  ASSERT_EQ(blocks.size(), 2u);
  EXPECT_THAT(blocks[0].options, ElementsAre("contact", "learning_rate"));
  EXPECT_THAT(blocks[0].rows, ElementsAre(SweepRow{"direct_toi", 10.0}, SweepRow{"event", 5.0}));
}

TEST(SweepSpec, ContactModelsHaveOptions) {
  const std::vector<SweepBlock> blocks =
      ParseSweep("contact=ncp:kappa=1e-6:kappa_grad=1e-4, xpbd:substeps=1; friction=0", TwoBalls());
  ASSERT_EQ(blocks.size(), 2u);
  EXPECT_THAT(blocks[0].rows, ElementsAre(SweepRow{"ncp:kappa=1e-6:kappa_grad=1e-4"}, SweepRow{"xpbd:substeps=1"}));
}

TEST(SweepSpec, ExplicitPointsFromAFile) {
  const std::string path = TempFile("sweep_points.csv");
  std::ofstream(path) << "stiffness,precision\n100,float\n200,double\n";
  const std::vector<SweepBlock> blocks = ParseSweep("@" + path + "; damping=1", TwoBalls());
  ASSERT_EQ(blocks.size(), 2u);
  EXPECT_THAT(blocks[0].rows, ElementsAre(SweepRow{100.0, "float"}, SweepRow{200.0, "double"}));
}

TEST(SweepSpec, ErrorsNamePlaceAndExpectation) {
  const std::string wrong_value = TempFile("sweep_wrong_value.csv");
  std::ofstream(wrong_value) << "stiffness,damping\n1,2\n3,4x\n";
  const std::string wrong_header = TempFile("sweep_wrong_header.csv");
  std::ofstream(wrong_header) << "stiffnes\n1\n";
  const struct {
    std::string text, place, expectation;
  } cases[] = {
      {"", "character 1", "an option"},
      {"stiffness", "character 10", "expected '='"},
      {"colour=1", "found 'colour'", "one of contact, solver, precision, seed, stiffness"},
      {"striker.colour=1", "character 1", "<body>.<field>"},
      {"target.force_x=1", "character 1", "<body>.<field>"},  // not controlled
      {"stiffness=1,", "character 13", "a number"},
      {"stiffness=1,x", "found 'x'", "a number"},
      {"stiffness=1,nan", "found 'nan'", "a number"},
      {"stiffness=1e999", "found '1e999'", "a number"},
      {"steps=1.5", "found '1.5'", "a whole number"},
      {"steps=1e10", "found '1e10'", "a whole number up to 1e9"},
      {"steps=1:3:lin:9", "character 7", "fewer values"},
      {"stiffness=1:2:3", "found '3'", "'lin' or 'log'"},
      {"stiffness=1:2:lag:3", "character 15", "'lin' or 'log'"},
      {"stiffness=1:2:lin", "character 18", "first:last:lin:count"},
      {"stiffness=1:2:lin:0", "found '0'", "1..1000000"},
      {"stiffness=-1:1:log:3", "found '-1'", "> 0, as the range is logarithmic"},
      {"stiffness=-1e308:1e308:lin:3", "found '1e308'", "closer to -1e308"},
      {"stiffness=1e-300:1e300:log:3", "found '1e300'", "closer to 1e-300"},
      {"stiffness=1e300:1e-300:log:3", "found '1e-300'", "closer to 1e300"},
      {"stiffness=0:1:lin:600000 & damping=0:1:lin:600000", "found '600000'", "at most 1000000 values in all ranges"},
      {"contact=direct_tio", "found 'direct_tio'", "direct_toi"},
      {"contact=lcp:convex:lin:2", "found 'convex'", "expected one of the options complementarity_aware of lcp"},
      {"contact=xpbd:substeps=0", "found 'substeps=0'", "a whole number in 1..10000"},
      {"contact=xpbd:kappa=1", "character 9", "options compliance, substeps, published_bound of xpbd"},
      {"solver=gd:hmp:lin:2", "found 'gd'", "no range"},
      {"stiffness=1;stiffness=2", "character 13", "each option once"},
      {"stiffness=1,2&damping=1,2,3", "found 'damping=1,2,3'", "2 values, as 'stiffness' has"},
      {"(stiffness,damping)=(1,2),(3)", "character 29", "expected ','"},
      {"(stiffness,damping)=(1,2),(3,4,5)", "character 31", "expected ')'"},
      {"stiffness=1 damping=2", "character 11", "a number"},
      {"@/nonexistent/points.csv", "/nonexistent/points.csv", "No such file"},
      {"@" + wrong_value, "sweep_wrong_value.csv, row 2, damping: found '4x'", "a number"},
      {"@" + wrong_header, "sweep_wrong_header.csv, header: found 'stiffnes'", "stiffness"},
  };
  for (const auto& [text, place, expectation] : cases) {
    try {
      ParseSweep(text, TwoBalls());
      ADD_FAILURE() << text << " is accepted";
    } catch (const InputError& error) {
      EXPECT_THAT(error.what(), AllOf(HasSubstr(place), HasSubstr(expectation))) << text;
    }
  }
}

// Flags that say how to run, not what.
bool IsOfTheRun(const std::string& flag) {
  return flag == "threads" || flag == "memory_limit" || flag == "point_seconds" || flag == "simulate_seconds";
}

TEST(SweepOptions, EveryNumericFlagCanBeSwept) {
  std::vector<gflags::CommandLineFlagInfo> flags;
  gflags::GetAllFlags(&flags);
  int numeric = 0;
  for (const gflags::CommandLineFlagInfo& flag : flags) {
    if (flag.filename.find("/src/programs/") == std::string::npos) continue;
    // Flags that saltus_sweep does not have.
    if (flag.filename.find("/src/programs/identify") != std::string::npos) continue;
    if (flag.filename.find("/src/programs/audit") != std::string::npos) continue;
    if (flag.type == "string" || flag.type == "bool" || IsOfTheRun(flag.name)) continue;
    ++numeric;
    EXPECT_TRUE(FindSweepOption(flag.name, TwoBalls()).has_value()) << "--" << flag.name;
  }
  EXPECT_GE(numeric, 7);
}

Request TwoBallsRequest() {
  Request request;
  request.scene = TwoBalls();
  request.contacts = {"direct_toi", "event"};
  request.solvers = {"gd"};
  return request;
}

TEST(SweepOptions, ChangeWhatTheyName) {
  Request request = TwoBallsRequest();
  const struct {
    const char* name;
    std::function<double()> value;
  } cases[] = {
      {"stiffness", [&] { return request.scene.contact.stiffness; }},
      {"steps", [&] { return request.scene.steps; }},
      {"gravity_y", [&] { return request.scene.gravity[1]; }},
      {"effort", [&] { return request.scene.objective.effort; }},
      {"learning_rate", [&] { return request.options.descent.learning_rate; }},
      {"target.mass", [&] { return request.scene.bodies[1].mass; }},
      {"target.position_y", [&] { return request.scene.bodies[1].position[1]; }},
      {"striker.force_y", [&] { return request.scene.control.initial[0][1]; }},
  };
  for (const auto& [name, value] : cases) {
    ASSERT_TRUE(FindSweepOption(name, request.scene)) << name;
    SetSweepOption(name, 77.0, &request);
    EXPECT_EQ(value(), 77) << name;
  }
  for (const char* name : {"seed", "search_seed", "search_memory"}) {
    Request other = request;
    EXPECT_THROW(SetSweepOption(name, -1.0, &other), InputError) << name;
  }
  EXPECT_THROW(SetSweepOption("learning_rate", -1.0, &request), InputError);
}

TEST(SweepOptions, NameThePairsOfMaterials) {
  Request request = TwoBallsRequest();
  request.scene.materials = {{"rubber", {0.9, 0.4}}, {"steel", {0.6, 0.2}}};
  request.scene.bodies[0].material = 0;
  request.scene.bodies[1].material = 1;
  EXPECT_FALSE(FindSweepOption("restitution", request.scene));
  EXPECT_FALSE(FindSweepOption("friction", request.scene));
  EXPECT_FALSE(FindSweepOption("restitution.rubber-stone", request.scene));
  EXPECT_FALSE(FindSweepOption("restitution.rubber-steel", TwoBalls()));
  const std::vector<SweepBlock> blocks = ParseSweep("restitution.steel-rubber=0.1,0.3", request.scene);
  SetSweepOption(blocks[0].options[0], 0.3, &request);
  EXPECT_EQ(ContactBetween(request.scene, 0, 1), (PairContact{0.3, 0.5 * (0.4 + 0.2)}));
  try {
    ParseSweep("restitution=0.1", request.scene);
    ADD_FAILURE() << "expected an error";
  } catch (const InputError& error) {
    EXPECT_THAT(error.what(), HasSubstr("restitution.rubber-steel, friction.rubber-steel"));
  }
  try {
    ParseSweep("restitution.rubber-steel=0.1;restitution.steel-rubber=0.2", request.scene);
    ADD_FAILURE() << "expected an error";
  } catch (const InputError& error) {
    EXPECT_THAT(error.what(), HasSubstr("expected each option once"));
  }
}

TEST(SweepStudy, CombinesBlocksWithTheLastFastest) {
  const Request request = TwoBallsRequest();
  const SweepStudy study(request, ParseSweep("stiffness=1,2&damping=3,4; steps=10,20,30", request.scene));
  EXPECT_THAT(study.options(), ElementsAre("stiffness", "damping", "steps", "contact", "solver"));
  ASSERT_EQ(study.size(), 2 * 3 * 2 * 1);
  EXPECT_EQ(study.Values(0), (SweepRow{1.0, 3.0, 10.0, "direct_toi", "gd"}));
  EXPECT_EQ(study.Values(1), (SweepRow{1.0, 3.0, 10.0, "event", "gd"}));
  EXPECT_EQ(study.Values(2), (SweepRow{1.0, 3.0, 20.0, "direct_toi", "gd"}));
  EXPECT_EQ(study.Values(11), (SweepRow{2.0, 4.0, 30.0, "event", "gd"}));
  EXPECT_EQ(study.RequestAt(11).scene.contact.damping, 4);
  EXPECT_THAT(study.RequestAt(11).contacts, ElementsAre("event"));
}

TEST(SweepStudy, ABlockWithContactModelsReplacesThoseOfTheFlag) {
  const Request request = TwoBallsRequest();
  const SweepStudy study(request, ParseSweep("(contact,stiffness)=(lcp,1),(direct,2)", request.scene));
  EXPECT_EQ(study.size(), 2);
  EXPECT_THAT(study.options(), ElementsAre("stiffness", "contact", "solver"));
  EXPECT_EQ(study.Values(1), (SweepRow{2.0, "direct", "gd"}));
}

TEST(SweepStudy, NoColumnBearsTheNameOfAnother) {
  const Request request = TwoBallsRequest();
  const SweepStudy study(request, ParseSweep("iterations=1,2", request.scene));
  const std::set<std::string> names(study.columns().begin(), study.columns().end());
  EXPECT_EQ(names.size(), study.columns().size());
}

TEST(SweepStudy, RefusesMorePointsThanItCanNumber) {
  const Request request = TwoBallsRequest();
  EXPECT_THROW(SweepStudy(request, ParseSweep("stiffness=1:2:lin:1000000; damping=1:2:lin:1000000", request.scene)),
               InputError);
}

TEST(SweepStudy, DescriptionsTellStudiesApart) {
  Request request = TwoBallsRequest();
  const auto describe = [&](const std::string& sweep) {
    return SweepStudy(request, ParseSweep(sweep, request.scene)).Description();
  };
  const std::string before = describe("stiffness=1,2");
  EXPECT_EQ(before, describe(" stiffness = 1:2:lin:2 "));
  EXPECT_THAT(DescribeDifference(before, describe("stiffness=1,3")), AllOf(HasSubstr("2.0"), HasSubstr("is now 3.0")));
  request.scene.steps = 240;
  EXPECT_THAT(DescribeDifference(before, describe("stiffness=1,2")),
              AllOf(HasSubstr("steps: 480"), HasSubstr("steps: 240")));
}

}  // namespace
}  // namespace saltus
