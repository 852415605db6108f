// Solvers along a sequence of impacts that is not that of an optimum: what it is mended to, and what is said of it.
#include "solve/phases/sequence_update.h"

#include <gmock/gmock.h>

#include <cmath>
#include <numbers>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "box_scene.h"
#include "parameter_name.h"
#include "saltus/simulate/exact_run.h"
#include "saltus/solve/solver.h"
#include "scene/control_problems.h"
#include "test_scenes.h"

namespace saltus {
namespace {

using testing::HasSubstr;
using testing::Not;

ExactRun Resimulate(const Scene& scene, const SolveReport& report) {
  return SimulateExactly(scene, report.solution.initial_state, report.solution.control, report.solution.durations);
}

Scene Unpushed(double duration, int steps, double restitution) {
  Scene scene;
  scene.name = "mended";
  scene.duration = duration;
  scene.steps = steps;
  scene.contact.restitution = restitution;
  scene.optimize = Optimize::kControl;
  return scene;
}

// A bounce only mirrors what follows. Unfolded, the way is straight but for the correction, and the least loss that of
// a free disc: k d^2 / (1 + k) with k = 3 effort / T^3 for a guess that misses by d.
double BoxOptimum(double loss_of_guess, const Scene& scene) {
  const double stiffness = 3 * scene.objective.effort / std::pow(scene.duration, 3);
  return loss_of_guess * stiffness / (1 + stiffness);
}

class BySequence : public testing::TestWithParam<std::string> {};

TEST_P(BySequence, ReachesTheOptimumAfterTenBounces) {
  const Scene scene = BallInBox(1, 500);
  const SolveReport report = Solve(GetParam(), {scene, "event"}, {});
  ASSERT_EQ(report.termination, Termination::kConverged) << report.reason;
  ASSERT_TRUE(report.certificate);
  EXPECT_EQ(report.certificate->verdict, Certificate::Verdict::kStationary) << report.certificate->reason;
  EXPECT_NEAR(report.solution.loss, BoxOptimum(report.guess.loss, scene), 1e-9);
  const ExactRun exact = Resimulate(scene, report);
  EXPECT_EQ(exact.events.size(), 10u);
  // The last two impacts of the guess come in the other order.
  EXPECT_EQ(exact.events[8].b, "left");
  EXPECT_EQ(exact.events[9].b, "floor");
  EXPECT_THAT(report.reason, HasSubstr("sequences passed"));
}

TEST_P(BySequence, ReachesTheOptimumAfterThirtySevenBounces) {
  const Scene scene = BallInBox(4, 2000);
  const SolveReport report = Solve(GetParam(), {scene, "event"}, {});
  EXPECT_EQ(report.termination, Termination::kConverged) << report.reason;
  EXPECT_NEAR(report.solution.loss, BoxOptimum(report.guess.loss, scene), 1e-11);
}

// The striker should be as slow as possible: it strikes when the time is over.
TEST_P(BySequence, StrikesAtTheFinalTime) {
  Scene scene = Unpushed(1, 200, 0.8);
  scene.bodies = {{.name = "striker", .radius = 0.2, .mass = 1, .position = {-1.5, 0.1}},
                  {.name = "target", .radius = 0.2, .mass = 1, .position = {0, 0}}};
  scene.control = {{0}, {{3, 0}}};
  scene.objective.terminal = {
      {.body = 1, .quantity = TerminalTerm::Quantity::kVelocity, .target = {1, 0.5}, .weight = 5}};
  scene.objective.effort = 0.02;
  const SolveReport report = Solve(GetParam(), {scene, "event"}, {});
  ASSERT_EQ(report.termination, Termination::kConverged) << report.reason;
  EXPECT_LT(report.solution.loss, 0.0838);
  const ExactRun exact = Resimulate(scene, report);
  EXPECT_NEAR(exact.loss, report.solution.loss, 1e-12);
  ASSERT_EQ(exact.events.size(), 1u);
  EXPECT_NEAR(exact.events[0].time, 1, 1e-6);
  EXPECT_THAT(report.reason, HasSubstr("striker-target (at the final time)"));
  ASSERT_TRUE(report.certificate);
  EXPECT_THAT(report.certificate->reason, HasSubstr("final time"));
}

// Head-on the ball is stationary at a saddle; on either side of it the best way leads past the post, which it touches.
// The loss of that in continuous time, by minimization over time, angle and speed of the touch alone: 2.711708788.
Scene HeadOnPost() {
  Scene scene = Unpushed(1, 200, 0.9);
  scene.bodies = {{.name = "ball", .radius = 0.1, .mass = 1, .position = {-1, 0}, .velocity = {2.5, 0}},
                  {.name = "post", .radius = 0.2, .fixed = true, .position = {0, 0}}};
  scene.control = {{0}, {{0, 0}}};
  scene.objective.terminal = {{.body = 0, .target = {1, 0}}};
  scene.objective.effort = 0.5;
  return scene;
}

TEST_P(BySequence, LeavesASaddleForAGraze) {
  Scene scene = HeadOnPost();
  const SolveReport report = Solve(GetParam(), {scene, "event"}, {});
  ASSERT_EQ(report.termination, Termination::kConverged) << report.reason;
  EXPECT_LT(report.solution.loss, 2.712);
  EXPECT_GT(report.solution.loss, 2.711708787);
  EXPECT_THAT(report.reason, HasSubstr("left a saddle"));
  EXPECT_THAT(report.reason, HasSubstr("none, ball-post apart"));
  const ExactRun exact = Resimulate(scene, report);
  EXPECT_TRUE(exact.events.empty());
  // With a post that is larger by less than a hair, the same control meets it.
  scene.bodies[1].radius += 1e-6;
  EXPECT_FALSE(Resimulate(scene, report).events.empty());
}

// A search certifies an optimum after its solve, and solves from a saddle once more.
TEST(SequenceUpdate, ASearchLeavesASaddle) {
  SolverOptions options;
  options.sequences.limits.starts = 0;
  const SolveReport report = Solve("mode_search", {HeadOnPost(), "event"}, options);
  ASSERT_EQ(report.termination, Termination::kConverged) << report.reason;
  EXPECT_LT(report.solution.loss, 2.712);
  EXPECT_GT(report.solution.loss, 2.711708787);
  for (const LocalOptimum& optimum : report.optima) EXPECT_TRUE(optimum.sequence.empty()) << optimum.loss;
}

INSTANTIATE_TEST_SUITE_P(Solvers, BySequence, testing::Values("ceres_phases", "ceres_event"), ParameterName());

// Through a gap between two posts that the guess bounces off.
TEST(CeresPhases, TouchesOnTheWayThroughAGap) {
  Scene scene = Unpushed(2, 400, 0.9);
  scene.bodies = {{.name = "ball", .radius = 0.1, .mass = 1, .position = {0, 0.1}},
                  {.name = "top", .radius = 0.3, .fixed = true, .position = {1, 0.45}},
                  {.name = "bottom", .radius = 0.3, .fixed = true, .position = {1, -0.45}}};
  scene.control = {{0}, {{1, 0.1}}};
  scene.objective.terminal = {{.body = 0, .target = {2, 0}}};
  scene.objective.effort = 0.01;
  const SolveReport report = Solve("ceres_phases", {scene, "event"}, {});
  ASSERT_EQ(report.termination, Termination::kConverged) << report.reason;
  EXPECT_LT(report.solution.loss, 0.014982);
  EXPECT_TRUE(Resimulate(scene, report).events.empty());
  // A post whose radius is greater by d costs d times the multiplier of the touch.
  ASSERT_TRUE(report.certificate);
  EXPECT_EQ(report.certificate->verdict, Certificate::Verdict::kStationaryOnGrid) << report.certificate->reason;
  ASSERT_EQ(report.certificate->impacts.size(), 1u);
  const ImpactCertificate& touch = report.certificate->impacts[0];
  EXPECT_EQ(touch.a, "ball");
  const auto least_loss = [&](double change) {
    Scene other = scene;
    for (const int post : {1, 2}) {
      if (other.bodies[post].name == touch.b) other.bodies[post].radius += change;
    }
    return Solve("ceres_phases",
                 {other, "event"},
                 {.guess = ControlGuess{report.solution.control, report.solution.durations}})
        .solution.loss;
  };
  EXPECT_NEAR(touch.multiplier, (least_loss(1e-4) - least_loss(-1e-4)) / 2e-4, 1e-3 * touch.multiplier);
  EXPECT_GT(touch.multiplier, 0);
  for (const int post : {1, 2}) scene.bodies[post].radius += 1e-6;
  EXPECT_FALSE(Resimulate(scene, report).events.empty());
}

// By Coulomb's law the ball slips at the start and sticks at the optimum: between them the loss has a kink at which a
// solve stops, and both sides are better tried.
TEST(CeresPhases, CrossesFromSlipToStick) {
  Scene scene = Unpushed(1.4, 60, 0.97);
  scene.contact.friction = 0.1675;
  scene.bodies = {{.name = "striker", .radius = 0.117, .mass = 0.6615, .position = {0, 0}},
                  {.name = "target", .radius = 0.1395, .mass = 0.6492, .position = {0.5443, 0.3169}}};
  scene.control = {{0}, {{1.08, 0.466}}};
  scene.objective.terminal = {
      {.body = 1, .target = {1.0475, 0.2777}},
      {.body = 0, .quantity = TerminalTerm::Quantity::kVelocity, .target = {0, 0}, .weight = 0.068}};
  scene.objective.effort = 0.0368;
  const SolveReport report = Solve("ceres_phases", {scene, "event"}, {.limits = {.iterations = 2000}});
  ASSERT_EQ(report.termination, Termination::kConverged) << report.reason;
  EXPECT_LT(report.solution.loss, 0.05);
  EXPECT_THAT(report.reason, HasSubstr("striker-target sticks"));
}

// A chain whose best motion touches once more, a pair that has struck before.
TEST(CeresPhases, KeepsApartWhatStrikesElsewhere) {
  Scene scene = ControlProblem(54);
  scene.steps = 240;
  const SolveReport report = Solve("ceres_phases", {scene, "event"}, {.limits = {.iterations = 2000}});
  ASSERT_EQ(report.termination, Termination::kConverged) << report.reason;
  EXPECT_THAT(report.reason, HasSubstr("striker-link0 apart"));
  EXPECT_EQ(Resimulate(scene, report).events.size(), 3u);
  // Arcs know nothing of that, and come down to it from above.
  const SolveReport arcs = Solve("ceres_event", {scene, "event"}, {.limits = {.iterations = 2000}});
  EXPECT_LT(report.solution.loss, arcs.solution.loss * (1 + 1e-6));
}

// The ball goes on to a wall when all is done: the plan has no such impact, the optimum has.
TEST(CeresPhases, TakesAnOptimumWithAnImpactThatChangesNothing) {
  Scene scene = ControlProblem(13);
  scene.steps = 240;
  const SolveReport report = Solve("ceres_phases", {scene, "event"}, {});
  ASSERT_EQ(report.termination, Termination::kConverged) << report.reason;
  EXPECT_EQ(Resimulate(scene, report).events.size(), 2u);
  ASSERT_TRUE(report.certificate);
  EXPECT_EQ(report.certificate->verdict, Certificate::Verdict::kStationary) << report.certificate->reason;
}

// Three impacts, after which a cost for every step ends in rounding before the conditions of optimality are met.
TEST(CeresPhases, ConvergesToTheLastDigits) {
  Scene scene = ControlProblem(42);
  scene.steps = 240;
  const SolveReport report = Solve("ceres_phases", {scene, "event"}, {});
  ASSERT_EQ(report.termination, Termination::kConverged) << report.reason;
  ASSERT_TRUE(report.certificate);
  EXPECT_EQ(report.certificate->verdict, Certificate::Verdict::kStationary) << report.certificate->reason;
}

TEST(CeresPhases, KeepsToASequenceThatIsGiven) {
  const Scene scene = BallInBox(1, 500);
  SolverOptions options;
  options.sequences.given = SimulateExactly(scene, InitialState(scene), InitialControl(scene, scene.steps)).contacts;
  const SolveReport report = Solve("ceres_phases", {scene, "event"}, options);
  EXPECT_NE(report.termination, Termination::kConverged);
  EXPECT_THAT(report.reason, Not(HasSubstr("passed")));
}

// Pushed with all its force along the diagonal, the striker gives the target its speed; after that there is no time to
// reach the origin.
TEST(CeresPhases, SaysWhatIsMissedAtLeastWhereTheTargetIsOutOfReach) {
  Scene scene = ProblemScene("two_balls");
  scene.objective.terminal[0].hard = true;
  scene.control.max = {3};
  const SolveReport report = Solve("ceres_phases", {scene, "event"}, {});
  EXPECT_EQ(report.termination, Termination::kNoProgress);
  EXPECT_THAT(report.reason, HasSubstr("the least violation is"));
  const double way = std::numbers::sqrt2 - 0.4, speed = std::sqrt(2 * way * 3 * std::numbers::sqrt2);
  const double miss = std::numbers::sqrt2 - (speed - 2 * way);
  EXPECT_THAT(report.reason, HasSubstr(" m, by target"));
  const ExactRun exact = Resimulate(scene, report);
  EXPECT_NEAR(std::hypot(exact.end[4], exact.end[5]), miss, 1e-5);
  EXPECT_THAT(report.reason, HasSubstr("0.5090")) << miss;
  for (const double force : report.solution.control) EXPECT_LE(std::abs(force), 3 * (1 + 1e-12));
}

// Within the bound it does not even get there, whatever the guess says.
TEST(CeresPhases, KeepsBoundsThatTheGuessDoesNot) {
  Scene scene = ProblemScene("two_balls");
  scene.objective.terminal[0].hard = true;
  scene.control.max = {1.2};
  const SolveReport report = Solve("ceres_phases", {scene, "event"}, {});
  EXPECT_EQ(report.termination, Termination::kNoProgress);
  EXPECT_THAT(report.reason, HasSubstr("1.41421 m, by target"));
  for (const double force : report.solution.control) EXPECT_LE(std::abs(force), 1.2 * (1 + 1e-12));
}

// Under a bound the best motion of this problem has an impact at the final time too, where the loss has a kink.
TEST(CeresPhases, ConvergesToAKinkUnderABound) {
  Scene scene = ControlProblem(72);
  scene.steps = 60;
  scene.control.max = {1.5};
  const SolveReport report = Solve("ceres_phases", {scene, "event"}, {});
  EXPECT_EQ(report.termination, Termination::kConverged) << report.reason;
  EXPECT_THAT(report.reason, HasSubstr("at the final time"));
  ASSERT_TRUE(report.certificate);
  EXPECT_THAT(report.certificate->reason, HasSubstr("final time"));
  EXPECT_NEAR(Resimulate(scene, report).loss, report.solution.loss, 1e-12);
  double largest = 0;
  for (const double force : report.solution.control) largest = std::max(largest, std::abs(force));
  EXPECT_NEAR(largest, 1.5, 1e-9);
}

// ---- Without a system: which plans come after what a solve along a plan finds, and which motion is reported

// A motion is its loss and its events.
struct PlainMotion {
  struct Event {
    double time = 0;
  };
  struct Exact {
    bool ok = true;
    std::string reason;
    double loss = 0;
    bool only_impacts = true;
    std::vector<int> contacts;
    std::vector<Event> events;
  };
  std::vector<double> control = {0}, durations = {1};
  Exact exact;
};

PlainMotion MotionWith(double loss, std::vector<int> events) {
  PlainMotion motion;
  motion.exact.loss = loss;
  motion.exact.contacts = std::move(events);
  return motion;
}

// Events are numbers. Control does nothing, so that only the attempts that a test makes up matter.
class PlainRun {
 public:
  using Event = int;
  using Motion = PlainMotion;
  using Plan = PlanOf<Event>;

  static constexpr bool kHoldsGuards = false;

  explicit PlainRun(Motion guess) : guess_(std::move(guess)) {}

  // The loss at which a motion is said to be stationary.
  double stationary_loss = -1;
  bool one_of_many = false;

  bool is_one_of_many() const { return one_of_many; }
  bool certifies() const { return true; }
  double most_loss() const { return INFINITY; }

  const SolverOptions& options() const { return options_; }
  const Motion& guess() const { return guess_; }
  const std::optional<std::vector<Event>>& given_sequence() const { return given_; }
  SolveReport& report() { return report_; }
  bool IsOutOfIterations() const { return false; }
  bool IsPossible(const Plan&) const { return true; }
  double MeritOf(const Motion& motion) const { return motion.exact.loss; }
  double ViolationOf(const Motion&) const { return 0; }
  Motion ClampToBounds(const Motion& motion) const { return motion; }
  void MoveWithin(Motion*) const {}
  void Simulate(Motion*) const {}
  void BlendStart(const Motion&, const Motion&, double, Motion*) const {}
  int control_width() const { return 1; }
  int num_steps() const { return 100; }
  std::string ReasonNoDerivative(const Motion&) const { return ""; }
  // The cuts are at equal distances.
  void PlanAlong(const std::vector<Event>& sequence, const Motion&, Plan* plan, std::vector<double>* times) const {
    plan->cuts.assign(sequence.begin(), sequence.end());
    for (size_t k = 1; k <= sequence.size(); ++k) times->push_back(double(k) / double(sequence.size() + 1));
  }
  std::vector<std::pair<size_t, int>> RegimesAtBorders(const Plan&, const Motion&) const { return {}; }
  std::vector<std::pair<Plan, std::vector<double>>> PlansOnGrid(const Motion&) const { return {}; }
  std::vector<std::pair<Plan, std::vector<double>>> PlansThroughTouches(const Motion&) const { return {}; }
  std::vector<std::pair<Plan, std::vector<double>>> PlansWithJumpsOnGrid(const Plan&, const Motion&) const {
    return {};
  }
  bool HasCertificate() const { return true; }
  Certificate Certify(const Motion& motion) const {
    Certificate certificate;
    const bool stationary = motion.exact.loss == stationary_loss;
    certificate.verdict = stationary ? Certificate::Verdict::kStationary : Certificate::Verdict::kNotStationary;
    return certificate;
  }
  size_t DirectionSize(const Motion&) const { return 1; }
  std::vector<Motion> SearchBothSides(const Motion&, const std::vector<double>&) const { return {}; }
  std::string NameOf(const std::vector<Event>&) const { return ""; }
  std::string NameOf(const Plan&) const { return ""; }
  std::string NamesOf(const std::vector<Plan>&) const { return ""; }
  std::string KinksOf(const Plan&) const { return ""; }
  std::string DescribeMiss(const Motion&) const { return ""; }
  std::string ReasonNotRealized(const Motion&, const std::vector<Event>&) const { return "it is not realized"; }
  SolveReport Finish(const Motion&, double loss, Termination termination, const std::string& reason) const {
    SolveReport report;
    report.solution.loss = loss;
    report.termination = termination;
    report.reason = reason;
    return report;
  }

 private:
  SolverOptions options_;
  Motion guess_;
  std::optional<std::vector<Event>> given_;
  SolveReport report_;
};

using PlainAttempt = PlanAttemptOf<PlainMotion>;

// An optimum along a plan whose events all close their gaps at unit speed.
PlainAttempt OptimumAlong(const PlainRun::Plan& plan, const PlanStartOf<PlainMotion>& start, double loss) {
  PlainAttempt attempt;
  attempt.valid = attempt.converged = attempt.realized = true;
  attempt.times = start.times;
  attempt.times.push_back(1);
  attempt.speeds.assign(plan.cuts.size(), -1);
  attempt.trial = MotionWith(loss, plan.Sequence());
  return attempt;
}

// The plans that are tried after one along `events` whose last event has become a graze.
std::vector<PlainRun::Plan> PlansAfterAGrazeAtTheEndOf(const std::vector<int>& events) {
  PlainRun run(MotionWith(3, events));
  std::vector<PlainRun::Plan> plans;
  SolveWithSequenceUpdates<PlainRun>(&run, [&](const auto& plan, const auto& start, const auto&) {
    plans.push_back(plan);
    if (plans.size() > 1) return PlainAttempt();
    PlainAttempt attempt = OptimumAlong(plan, start, 2);
    attempt.speeds.back() = 0;
    return attempt;
  });
  EXPECT_FALSE(plans.empty());
  if (!plans.empty()) plans.erase(plans.begin());
  return plans;
}

TEST(SequenceUpdate, KeepsTheGapOfAGrazeOpen) {
  const std::vector<PlainRun::Plan> plans = PlansAfterAGrazeAtTheEndOf({1, 2});
  ASSERT_EQ(plans.size(), 1u);
  EXPECT_THAT(plans[0].Sequence(), testing::ElementsAre(1));
  EXPECT_THAT(plans[0].apart, testing::ElementsAre(2));
}

// Else the gap would have to stay open near the event that goes on, where it closes.
TEST(SequenceUpdate, LetsTheGapOfAGrazeCloseBesideTheSameEvent) {
  const std::vector<PlainRun::Plan> plans = PlansAfterAGrazeAtTheEndOf({2, 2});
  ASSERT_EQ(plans.size(), 1u);
  EXPECT_THAT(plans[0].Sequence(), testing::ElementsAre(2));
  EXPECT_THAT(plans[0].apart, testing::IsEmpty());
}

// Each attempt ends at a motion with one event more than its plan, which is better by a thousandth.
int AttemptsWithoutOptimum(bool one_of_many) {
  PlainRun run(MotionWith(1, {1}));
  run.one_of_many = one_of_many;
  int attempts = 0;
  SolveWithSequenceUpdates<PlainRun>(&run, [&](const auto& plan, const auto& start, const auto&) {
    PlainAttempt attempt = OptimumAlong(plan, start, 0);
    attempt.converged = attempt.realized = false;
    std::vector<int> events = plan.Sequence();
    events.push_back(1);
    attempt.trial = MotionWith(1 - 1e-3 * ++attempts, events);
    return attempt;
  });
  return attempts;
}

TEST(SequenceUpdate, GivesUpOneOfManyStartsWithoutABetterMotion) {
  EXPECT_EQ(AttemptsWithoutOptimum(/*one_of_many=*/false), mending::kMostAttempts);
  EXPECT_EQ(AttemptsWithoutOptimum(/*one_of_many=*/true), mending::kPatienceOfMany + 1) << "the first is the best";
}

// The solve of a plan whose two events stay at nearly the same time.
TEST(SequenceUpdate, LeavesAPlanWhosePhaseDoesNotComeBack) {
  PlainRun run(MotionWith(3, {1, 2}));
  int iterations = 0;
  std::vector<PlainRun::Plan> plans;
  SolveWithSequenceUpdates<PlainRun>(&run,
                                     [&](const auto& plan, const auto& start, const ContinuePredicate& may_go_on) {
                                       plans.push_back(plan);
                                       PlainAttempt attempt = OptimumAlong(plan, start, 2);
                                       if (plans.size() > 1) return attempt;
                                       attempt.times = {0.5, 0.5 + 1e-6, 1};
                                       attempt.converged = attempt.realized = false;
                                       attempt.trial = MotionWith(INFINITY, {1, 2});
                                       while (iterations < 400 && may_go_on(attempt.times, attempt.speeds))
                                         ++iterations;
                                       return attempt;
                                     });
  EXPECT_EQ(iterations, mending::kMostVanished);
  ASSERT_GE(plans.size(), 2u);
  EXPECT_THAT(plans[1].Sequence(), testing::ElementsAre(2, 1));
}

// Along the only sequence that is tried the optimum is worse than the guess.
SolveReport WhereTheOptimumIsWorse(double stationary_loss) {
  PlainRun run(MotionWith(1, {1}));
  run.stationary_loss = stationary_loss;
  return SolveWithSequenceUpdates<PlainRun>(
      &run, [&](const auto& plan, const auto& start, const auto&) { return OptimumAlong(plan, start, 2); });
}

TEST(SequenceUpdate, TakesTheBestMotionIfItIsStationary) {
  const SolveReport report = WhereTheOptimumIsWorse(1);
  EXPECT_EQ(report.termination, Termination::kConverged) << report.reason;
  EXPECT_EQ(report.solution.loss, 1);
}

// A plan without a real motion has a lower loss than the best motion, along which no solve converges.
TEST(SequenceUpdate, NamesTheBetterPlanThatIsNoMotion) {
  PlainRun run(MotionWith(3, {1, 2}));
  int attempts = 0;
  const SolveReport report =
      SolveWithSequenceUpdates<PlainRun>(&run, [&](const auto& plan, const auto& start, const auto&) {
        PlainAttempt attempt = OptimumAlong(plan, start, 2.0 - 0.1 * ++attempts);
        attempt.converged = attempts == 1;
        attempt.realized = attempts > 1;
        attempt.planned_loss = 1;
        if (attempts == 1) attempt.trial.exact.contacts = {1};
        return attempt;
      });
  EXPECT_GE(attempts, 2);
  EXPECT_EQ(report.termination, Termination::kNoProgress);
  EXPECT_THAT(report.reason, HasSubstr("lower is the loss of a plan, but it is not realized"));
}

TEST(SequenceUpdate, SaysThatTheLastSolveHasNotConverged) {
  PlainRun run(MotionWith(3, {1, 2}));
  bool converges = false;
  const auto solve = [&] {
    return SolveWithSequenceUpdates<PlainRun>(&run, [&](const auto& plan, const auto& start, const auto&) {
      PlainAttempt attempt = OptimumAlong(plan, start, 4);
      attempt.converged = converges;
      attempt.realized = false;
      return attempt;
    });
  };
  EXPECT_THAT(solve().reason, HasSubstr("has not converged"));
  converges = true;
  EXPECT_THAT(solve().reason, HasSubstr("it is not realized"));
}

TEST(SequenceUpdate, SaysThatTheBestMotionIsNoOptimum) {
  const SolveReport report = WhereTheOptimumIsWorse(2);
  EXPECT_EQ(report.termination, Termination::kNoProgress);
  EXPECT_EQ(report.solution.loss, 1);
  EXPECT_THAT(report.reason, HasSubstr("no optimum found has a lower loss than the motion returned"));
}

}  // namespace
}  // namespace saltus
