// hmp and ceres_event against the closed forms of two discs, against each other where there is none, and how they end.
#include <gmock/gmock.h>

#include <cmath>

#include "parameter_name.h"
#include "saltus/simulate/exact_run.h"
#include "saltus/simulate/simulator.h"
#include "saltus/solve/solver.h"
#include "test_scenes.h"

namespace saltus {
namespace {

using testing::HasSubstr;

ContactSequence Sequence(const Scene& scene, const std::string& text) {
  ContactSequence sequence;
  EXPECT_EQ(ParseContactSequence(scene, text, &sequence), "");
  return sequence;
}

ExactRun Resimulate(const Scene& scene, const SolveReport& report) {
  return SimulateExactly(scene, report.solution.initial_state, report.solution.control, report.solution.durations);
}

struct Reference {
  const char* problem;
  double loss, time, speed;  // data: hybrid minimum principle in 30 digits
};

class TwoDiscs : public testing::TestWithParam<Reference> {};

TEST_P(TwoDiscs, HmpMeetsTheReferenceToRounding) {
  const Scene scene = ProblemScene(GetParam().problem);
  const SolveReport report = Solve("hmp", {scene, "event"}, {});
  ASSERT_EQ(report.termination, Termination::kConverged) << report.reason;
  EXPECT_NEAR(report.solution.loss, GetParam().loss, 1e-12);
  ASSERT_TRUE(report.continuous);
  ASSERT_EQ(report.continuous->impacts.size(), 1u);
  EXPECT_NEAR(report.continuous->impacts[0].time, GetParam().time, 1e-12);
  EXPECT_NEAR(report.continuous->impacts[0].speed, GetParam().speed, 1e-12);
  EXPECT_EQ(report.continuous->verdict, Certificate::Verdict::kStationary);
  EXPECT_LT(report.continuous->hamiltonian, 1e-12);
  // The control reported is the best on its intervals, and so is its certificate.
  const ExactRun exact = Resimulate(scene, report);
  ASSERT_EQ(exact.events.size(), 1u);
  EXPECT_NEAR(exact.loss, GetParam().loss, 1e-6);
  const Certificate certificate =
      Certify(scene, report.solution.initial_state, report.solution.control, report.solution.durations);
  EXPECT_EQ(certificate.verdict, Certificate::Verdict::kStationary) << certificate.reason;
  ASSERT_TRUE(report.certificate);
  EXPECT_EQ(report.certificate->verdict, Certificate::Verdict::kStationary);
  EXPECT_EQ(report.certificate->impacts[0].time, certificate.impacts[0].time);
}

TEST_P(TwoDiscs, CeresEventComesNearInFewIterations) {
  for (const auto& [steps, tolerance] : {std::pair(480, 1e-6), std::pair(4800, 1e-8)}) {
    Scene scene = ProblemScene(GetParam().problem);
    scene.steps = steps;
    const SolveReport report = Solve("ceres_event", {scene, "event"}, {});
    ASSERT_EQ(report.termination, Termination::kConverged) << report.reason;
    EXPECT_LE(report.work.iterations, 50);
    EXPECT_EQ(report.solution.durations.size(), static_cast<size_t>(steps));
    EXPECT_EQ(report.solution.control.size(), 2u * steps);
    const ExactRun exact = Resimulate(scene, report);
    EXPECT_NEAR(exact.loss, GetParam().loss, tolerance);
    EXPECT_GT(exact.loss, GetParam().loss);
    EXPECT_NEAR(exact.loss, report.solution.loss, 1e-12);
  }
}

INSTANTIATE_TEST_SUITE_P(
    Problems, TwoDiscs,
    testing::Values(Reference{"two_balls", 1.396542160123197291, 0.6832202304916966260, 2.554108771038524035},
                    Reference{"single_collision", 0.3114168703584716754, 0.46070799815584204076, 2.298216622119576}),
    [](const auto& at) { return at.param.problem; });

TEST(CeresEvent, NeedsAtMostThirtyIterationsOnTwoBalls) {
  const SolveReport report = Solve("ceres_event", {ProblemScene("two_balls"), "event"}, {});
  EXPECT_LE(report.work.iterations, 30);
}

TEST(Hmp, TakesASequence) {
  const Scene scene = ProblemScene("multiple_collisions");
  SolverOptions options;
  options.sequences.given = Sequence(scene, "target-striker,target-ceiling");
  const SolveReport report = Solve("hmp", {scene, "event"}, options);
  ASSERT_EQ(report.termination, Termination::kConverged) << report.reason;
  EXPECT_NEAR(report.solution.loss, 0.3736363502324362710513, 1e-12);
  ASSERT_TRUE(report.continuous);
  ASSERT_EQ(report.continuous->impacts.size(), 2u);
  EXPECT_NEAR(report.continuous->impacts[0].time, 0.56208767372745729796, 1e-12);
  EXPECT_NEAR(report.continuous->impacts[1].time, 0.66218262880491428143, 1e-12);
}

// Three bodies in a chain, restitution, friction, gravity, velocity terms, two pushed discs: no closed form. One solver
// minimises the loss, the other meets the costate conditions; exact re-simulation has the last word.
struct Case {
  const char* name;
  Scene scene;
  const char* sequence = "a-b,b-c";
};
void PrintTo(const Case& item, std::ostream* out) { *out << item.name; }

SolveReport SolveCase(const Case& item, const char* solver) {
  SolverOptions options;
  options.sequences.given = Sequence(item.scene, item.sequence);
  return Solve(solver, {item.scene, "event"}, options);
}

Scene Chain() {
  Scene scene;
  scene.name = "chain";
  scene.duration = 1;
  scene.steps = 2000;
  scene.bodies = {{.name = "a", .radius = 0.1, .mass = 1, .position = {0, 0}},
                  {.name = "b", .radius = 0.1, .mass = 1.6, .position = {0.6, 0.05}},
                  {.name = "c", .radius = 0.15, .mass = 1, .position = {1.1, 0.02}}};
  scene.control = {{0}, {{8, 0.6}}};
  scene.objective.terminal = {{.body = 2, .target = {1.7, 0.1}, .weight = 3}};
  scene.objective.effort = 0.02;
  scene.optimize = Optimize::kControl;
  return scene;
}

Scene With(Scene scene, double restitution, double friction, const Vec2d& gravity) {
  scene.contact.restitution = restitution;
  scene.contact.friction = friction;
  scene.gravity = gravity;
  return scene;
}

// The discs slide well along each other: an optimum on the border of slip and stick would be a kink.
Scene SlidingChain() {
  Scene scene = Chain();
  scene.bodies[1].position = {0.6, -0.25};
  scene.bodies[1].velocity = {0, 0.8};
  return scene;
}

Scene WithVelocityTerms(Scene scene) {
  scene.objective.terminal.push_back(
      {.body = 2, .quantity = TerminalTerm::Quantity::kVelocity, .target = {1, 0.2}, .weight = 0.3});
  scene.objective.terminal.push_back({.body = 0, .target = {0.7, -0.2}, .weight = 0.5});
  scene.objective.terminal.push_back(
      {.body = 0, .quantity = TerminalTerm::Quantity::kVelocity, .target = {0, 0}, .weight = 0.2});
  return scene;
}

// A disc that strikes the ground, sliding or sticking, and is pushed on.
Scene Bounce(double friction) {
  Scene scene;
  scene.name = "bounce";
  scene.duration = 1;
  scene.steps = 2000;
  scene.gravity = {0, -3};
  scene.bodies = {{.name = "ball", .radius = 0.1, .mass = 1.2, .position = {0, 1}, .velocity = {1, -1}}};
  scene.planes = {{"ground", {0, 0}, {0.1, 1}}};
  scene.contact = {.restitution = 0.7, .friction = friction};
  scene.control = {{0}, {{0.3, 0}}};
  scene.objective.terminal = {{.body = 0, .target = {1.3, 0.9}, .weight = 4}};
  scene.objective.effort = 0.1;
  scene.optimize = Optimize::kControl;
  return scene;
}

Scene TwoPushed() {
  Scene scene = Chain();
  scene.bodies.pop_back();
  scene.control = {{0, 1}, {{7, 0}, {-2, 0.3}}};
  scene.objective.terminal = {{.body = 1, .target = {1.2, 0.4}, .weight = 3}};
  return scene;
}

class General : public testing::TestWithParam<Case> {};

TEST_P(General, TwoMethodsAgree) {
  const Scene& scene = GetParam().scene;
  const SolveReport indirect = SolveCase(GetParam(), "hmp");
  const SolveReport direct = SolveCase(GetParam(), "ceres_event");
  ASSERT_EQ(indirect.termination, Termination::kConverged) << indirect.reason;
  ASSERT_EQ(direct.termination, Termination::kConverged) << direct.reason;
  EXPECT_LT(direct.solution.loss, 0.9 * direct.guess.loss);
  // Second order in the step, from above.
  EXPECT_NEAR(direct.solution.loss, indirect.solution.loss, 2e-6 * indirect.solution.loss);
  EXPECT_GT(direct.solution.loss, indirect.solution.loss - 1e-12);
  const ExactRun exact = Resimulate(scene, direct);
  EXPECT_NEAR(exact.loss, direct.solution.loss, 1e-10);
  ASSERT_EQ(exact.events.size(), indirect.certificate->impacts.size());
  for (size_t k = 0; k < exact.events.size(); ++k) {
    EXPECT_NEAR(exact.events[k].time, indirect.certificate->impacts[k].time, 1e-4) << k;
  }
}

// The certificate knows nothing of phases: it reads the costates off the control and the exact motion.
TEST_P(General, BothAreCertified) {
  const Scene& scene = GetParam().scene;
  EXPECT_EQ(SolveCase(GetParam(), "hmp").certificate->verdict, Certificate::Verdict::kStationary);
  const SolveReport report = SolveCase(GetParam(), "ceres_event");
  const Certificate certificate =
      Certify(scene, report.solution.initial_state, report.solution.control, report.solution.durations);
  EXPECT_EQ(certificate.verdict, Certificate::Verdict::kStationary) << certificate.reason;
  EXPECT_LT(certificate.costate_jump, 1e-6);
  EXPECT_LT(certificate.hamiltonian, 1e-6);
  SolveReport changed = report;
  changed.solution.control[report.solution.control.size() / 8 * 2] *= 1.01;
  EXPECT_EQ(
      Certify(scene, changed.solution.initial_state, changed.solution.control, changed.solution.durations).verdict,
      Certificate::Verdict::kNotStationary);
}

// The control found is better than its neighbours, judged by exact simulation alone.
TEST_P(General, NoPerturbationIsBetter) {
  const Scene& scene = GetParam().scene;
  const SolveReport report = SolveCase(GetParam(), "ceres_event");
  ASSERT_EQ(report.termination, Termination::kConverged) << report.reason;
  const double loss = Resimulate(scene, report).loss;
  for (int wave = 0; wave < 6; ++wave) {
    SolveReport moved = report;
    for (size_t i = 0; i < moved.solution.control.size(); ++i) {
      moved.solution.control[i] += 1e-3 * std::cos(0.003 * (wave / 2) * i + (i % 2 == 0 ? 1 : 2) * wave);
    }
    EXPECT_GT(Resimulate(scene, moved).loss, loss) << wave;
  }
}

INSTANTIATE_TEST_SUITE_P(
    Scenes, General,
    testing::Values(Case{"chain", Chain()}, Case{"inelastic_chain", With(Chain(), 0.6, 0, {0, 0})},
                    Case{"slipping_chain", With(SlidingChain(), 0.8, 0.05, {0, 0})},
                    Case{"sticking_chain", With(Chain(), 0.8, 1.5, {0, 0})},
                    Case{"falling_chain", With(SlidingChain(), 0.9, 0.03, {0.2, -1})},
                    Case{"velocity_terms", WithVelocityTerms(With(SlidingChain(), 0.9, 0.03, {0.2, -1}))},
                    Case{"bounce", Bounce(0), "ball-ground"}, Case{"slipping_bounce", Bounce(0.1), "ball-ground"},
                    Case{"sticking_bounce", Bounce(2), "ball-ground"}, Case{"two_pushed", TwoPushed(), "a-b"}),
    [](const auto& at) { return at.param.name; });

class ByPhases : public testing::TestWithParam<std::string> {};

TEST_P(ByPhases, SaysWhyNot) {
  const auto reason = [](const Scene& scene, const char* contact = "event") {
    const SolveReport report = Solve(GetParam(), {scene, contact}, {});
    EXPECT_EQ(report.termination, Termination::kNotApplicable);
    return report.reason;
  };
  Scene scene = ProblemScene("two_balls");
  EXPECT_THAT(reason(scene, "direct_toi"), HasSubstr("requires exact impacts"));
  scene.objective.effort = 0;
  EXPECT_THAT(reason(scene), HasSubstr("effort"));
  scene = ProblemScene("two_balls");
  scene.control.initial = {{-1, 0}};
  EXPECT_THAT(reason(scene), HasSubstr("no contact in the sequence"));
  EXPECT_THAT(reason(ProblemScene("ground_wall")), HasSubstr("control"));
  scene = ProblemScene("bounce_once");
  EXPECT_THAT(reason(scene), HasSubstr("nothing to optimize"));
  scene.optimize = Optimize::kControl;
  scene.objective.effort = 0.1;
  EXPECT_THAT(reason(scene), HasSubstr("sum of squares"));
}

TEST_P(ByPhases, StopsWhenTold) {
  SolverOptions options;
  options.monitor.callback = [](int iteration, double) { return iteration < 3; };
  const SolveReport report = Solve(GetParam(), {ProblemScene("single_collision"), "event"}, options);
  EXPECT_EQ(report.termination, Termination::kInterrupted);
  EXPECT_EQ(report.work.iterations, 3);
}

// Along "striker-target" alone the target would be shot through a wall.
TEST_P(ByPhases, DoesNotCallAnImpossibleMotionConverged) {
  Scene scene = ProblemScene("two_balls");
  scene.planes = {{"wall", {-0.5, 0}, {-1, 0}}};
  SolverOptions options;
  options.sequences.given = Sequence(scene, "striker-target");
  const SolveReport report = Solve(GetParam(), {scene, "event"}, options);
  EXPECT_EQ(report.termination, Termination::kNoProgress);
  EXPECT_THAT(report.reason, HasSubstr("target-wall"));
}

INSTANTIATE_TEST_SUITE_P(Solvers, ByPhases, testing::Values("hmp", "ceres_event"), ParameterName());

}  // namespace
}  // namespace saltus
