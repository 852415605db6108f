// The search for the collision sequence, on problems that nobody told it the sequence of.
#include <gmock/gmock.h>

#include <algorithm>
#include <cmath>

#include "saltus/control/exact_run.h"
#include "saltus/solve/solver.h"
#include "test_scenes.h"

namespace saltus {
namespace {

using testing::HasSubstr;

std::string Named(const Scene& scene, const ContactSequence& sequence) {
  return ContactSequenceToString(scene, sequence);
}

const LocalOptimum* Find(const SolveReport& report, double loss, double tolerance) {
  for (const LocalOptimum& optimum : report.optima) {
    if (std::abs(optimum.loss - loss) < tolerance) return &optimum;
  }
  return nullptr;
}

TEST(ModeSearch, FindsABetterSequenceThanThePublishedOne) {
  const Scene scene = ProblemScene("multiple_collisions");
  const SolveReport report = Solve("mode_search", {scene, "event"}, {});
  ASSERT_EQ(report.termination, Termination::kConverged) << report.reason;
  EXPECT_LT(report.final_loss, 0.3563);
  const ExactRun exact = SimulateExactly(scene, report.initial_state, report.control, report.durations);
  EXPECT_LT(exact.loss, 0.3563);
  ASSERT_FALSE(report.optima.empty());
  EXPECT_EQ(exact.contacts, report.optima[0].sequence);
  EXPECT_TRUE(std::is_sorted(report.optima.begin(),
                             report.optima.end(),
                             [](const LocalOptimum& a, const LocalOptimum& b) { return a.loss < b.loss; }));

  // The published optimum (exact references: 0.3736363502 in continuous time) is one of the others.
  const LocalOptimum* published = Find(report, 0.3736363502, 1e-6);
  ASSERT_NE(published, nullptr);
  EXPECT_EQ(Named(scene, published->sequence), "striker-target,target-ceiling");

  ASSERT_TRUE(report.certificate);
  EXPECT_EQ(report.certificate->verdict, Certificate::Verdict::kStationary) << report.certificate->reason;
  EXPECT_EQ(report.certificate->scope, Certificate::Scope::kBestOfSearched);
  EXPECT_GT(report.certificate->sequences_searched, 5);
}

TEST(ModeSearch, AgreesWithTheClosedFormWhereThereIsOneSequence) {
  const SolveReport report = Solve("mode_search", {ProblemScene("two_balls"), "event"}, {});
  ASSERT_EQ(report.termination, Termination::kConverged) << report.reason;
  EXPECT_NEAR(report.final_loss, 1.396542160123197, 1e-6);
  EXPECT_NE(Find(report, 2, 1e-12), nullptr);  // doing nothing is the other optimum
}

// The initial guess misses; nothing but the search leads to an impact.
TEST(ModeSearch, FindsAnImpactThatTheGuessDoesNotHave) {
  Scene scene = ProblemScene("two_balls");
  scene.control.initial = {{-1, 0.5}};
  const SolveReport report = Solve("mode_search", {scene, "event"}, {});
  ASSERT_EQ(report.termination, Termination::kConverged) << report.reason;
  EXPECT_NEAR(report.final_loss, 1.396542160123197, 1e-6);
}

TEST(ModeSearch, KeepsToASequenceThatIsGiven) {
  const Scene scene = ProblemScene("multiple_collisions");
  SolverOptions options;
  options.search = false;
  ASSERT_EQ(ParseContactSequence(scene, "striker-target,target-ceiling", &options.sequence.emplace()), "");
  const SolveReport report = Solve("mode_search", {scene, "event"}, options);
  ASSERT_EQ(report.termination, Termination::kConverged) << report.reason;
  EXPECT_NEAR(report.final_loss, 0.3736363502, 1e-6);
  EXPECT_EQ(report.optima.size(), 1u);
  EXPECT_EQ(report.certificate->scope, Certificate::Scope::kLocal);
}

TEST(ModeSearch, ReportsWhatItHasWhenInterrupted) {
  SolverOptions options;
  int solves = 0;
  std::string last;
  options.status = [&](const std::string& note) {
    ++solves;
    last = note;
  };
  options.callback = [&](int, double) { return solves < 12; };
  const SolveReport report = Solve("mode_search", {ProblemScene("multiple_collisions"), "event"}, options);
  EXPECT_EQ(report.termination, Termination::kInterrupted);
  EXPECT_GE(solves, 12);
  EXPECT_THAT(last, HasSubstr("best"));
  EXPECT_FALSE(report.control.empty());
  EXPECT_FALSE(report.certificate && report.certificate->scope == Certificate::Scope::kBestOfSearched);
}

TEST(ModeSearch, StopsAfterSoManySolves) {
  const SolveReport report = Solve("mode_search", {ProblemScene("multiple_collisions"), "event"}, {.iterations = 5});
  EXPECT_EQ(report.termination, Termination::kIterationLimit);
  EXPECT_EQ(report.iterations, 5);
}

TEST(ContactSequence, ReadsPairsInAnyOrder) {
  const Scene scene = ProblemScene("multiple_collisions");
  ContactSequence sequence;
  EXPECT_EQ(ParseContactSequence(scene, "target-striker,ceiling-target", &sequence), "");
  EXPECT_EQ(sequence, (ContactSequence{{0, 1, false}, {1, 0, true}}));
  EXPECT_EQ(Named(scene, sequence), "striker-target,target-ceiling");
  EXPECT_EQ(ParseContactSequence(scene, "none", &sequence), "");
  EXPECT_TRUE(sequence.empty());
}

TEST(ContactSequence, TwoReadingsAreRefused) {
  Scene scene = ProblemScene("multiple_collisions");
  scene.bodies[0].name = "a-b";
  scene.bodies[1].name = "c";
  scene.planes[0].name = "b-c";
  scene.bodies.push_back({.name = "a", .radius = 0.1, .position = {0, -9}});
  ContactSequence sequence;
  EXPECT_THAT(ParseContactSequence(scene, "a-b-c", &sequence), HasSubstr("'a-b-c' could be a and b-c, or a-b and c"));
  EXPECT_EQ(ParseContactSequence(scene, "c-a-b,b-c-a", &sequence), "");
  EXPECT_EQ(sequence, (ContactSequence{{0, 1, false}, {2, 0, true}}));
}

TEST(ContactSequence, FixedDiscsAndPlanesDoNotCollide) {
  Scene scene = ProblemScene("multiple_collisions");
  scene.bodies[1].fixed = true;
  ContactSequence sequence;
  EXPECT_EQ(ParseContactSequence(scene, "target-striker", &sequence), "");
  for (const char* text : {"target-ceiling", "ceiling-target", "ceiling-ceiling", "striker-striker"}) {
    EXPECT_THAT(ParseContactSequence(scene, text, &sequence), HasSubstr("no pair that can collide")) << text;
  }
}

TEST(ContactSequence, SaysWhatIsWrong) {
  const Scene scene = ProblemScene("multiple_collisions");
  ContactSequence sequence;
  for (const char* text : {"", "striker", "striker-target,", "striker-floor", "striker-target;target-ceiling"}) {
    EXPECT_THAT(ParseContactSequence(scene, text, &sequence), HasSubstr("striker-target, striker-ceiling")) << text;
  }
}

}  // namespace
}  // namespace saltus
