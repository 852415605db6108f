// Discs that spin above the contact models: what takes them and what does not, gradients, units, and the optimum of a
// control that can spin a disc only by the wall (data/spin_references.json).
#include <gmock/gmock.h>

#include <algorithm>
#include <cmath>

#include "rescaled_scene.h"
#include "saltus/audit/audit.h"
#include "saltus/audit/contact_class.h"
#include "saltus/control/single_shooting.h"
#include "saltus/optimality/certificate.h"
#include "saltus/simulate/exact_run.h"
#include "saltus/simulate/registry.h"
#include "saltus/solve/solver.h"
#include "spin_control.h"
#include "spinning_disc.h"
#include "test_scenes.h"

namespace saltus {
namespace {

using ::testing::HasSubstr;

// Two discs that meet, and a wall.
Scene Pair() {
  Scene scene;
  scene.name = "pair";
  scene.duration = 1.2;
  scene.steps = 480;
  scene.bodies = {Spinning("a", 0.1, 1, {0, 0}, {3, 0.5}, 20), Spinning("b", 0.15, 2, {1, 0.25}, {-0.5, 0}, -10)};
  scene.planes = {{"wall", {0, 1}, {0, -1}}};
  scene.contact = {.restitution = 0.9, .friction = 0.2};
  using Quantity = TerminalTerm::Quantity;
  scene.objective.terminal = {{.body = 0, .target = {0.3, -1}},
                              {.body = 0, .quantity = Quantity::kAngle, .target = {25, 0}, .weight = 0.01},
                              {.body = 1, .quantity = Quantity::kAngularVelocity, .target = {-4, 0}, .weight = 0.1},
                              {.body = 1, .quantity = Quantity::kVelocity, .target = {1, 1}}};
  scene.optimize = Optimize::kVelocity;
  scene.free = {0, 1};
  scene.free_spin = {1};
  return scene;
}

std::vector<std::string> ModelsThatSpin(const Scene& scene) {
  std::vector<std::string> names;
  for (const ModelTraits& traits : AllContactModels()) {
    if (ReasonNotApplicable(traits.name, scene).empty()) names.emplace_back(traits.name);
  }
  return names;
}

std::vector<double> EndOf(const Contact& contact, const Scene& scene) {
  const std::unique_ptr<Simulator> simulator = MakeSimulator(contact, scene, Precision::kDouble);
  EXPECT_TRUE(simulator->Rollout(InitialState(scene), InitialControl(scene, simulator->num_steps())))
      << contact.name() << ": " << simulator->FailureReason();
  std::vector<double> end(simulator->state_size());
  simulator->GetState(simulator->num_steps(), end);
  return end;
}

TEST(SpinModels, TakeTheSceneOrSayWhyNot) {
  const Scene scene = Pair();
  EXPECT_THAT(ModelsThatSpin(scene), ::testing::IsSupersetOf({"event", "compliant_brax", "pbd_brax"}));
  for (const ModelTraits& traits : AllContactModels()) {
    const std::string why = ReasonNotApplicable(traits.name, scene);
    if (why.empty() || !traits.friction) continue;
    EXPECT_THAT(why, HasSubstr("spin")) << traits.name;
  }
}

TEST(SpinModels, SpinOnNothing) {
  Scene scene = Pair();
  scene.planes.clear();
  scene.bodies[1].position = {0, 9};
  scene.bodies[0].angular_velocity = 2;
  scene.bodies[0].angle = 0.25;
  for (const std::string& name : ModelsThatSpin(scene)) {
    const std::vector<double> end = EndOf(name, scene);
    // A model may take the sine of the half angle of a step for that angle.
    const double slack = scene.duration * scene.dt() * 2;
    EXPECT_NEAR(end[5], 2, slack) << name;
    EXPECT_NEAR(end[4], 0.25 + 2 * scene.duration, slack) << name;
  }
}

TEST(SpinModels, MirroredSceneMirrored) {
  Scene scene = Pair();
  scene.bodies[0].angular_velocity = 4;
  Scene mirrored = scene;
  for (Body& body : mirrored.bodies) {
    body.position[0] *= -1;
    body.velocity[0] *= -1;
    body.angular_velocity *= -1;
  }
  for (const std::string& name : ModelsThatSpin(scene)) {
    const std::vector<double> end = EndOf(name, scene), other = EndOf(name, mirrored);
    for (int i = 0; i < 12; ++i) {
      const int j = i % 6;
      const bool turns = j == 0 || j == 2 || j > 3;
      EXPECT_NEAR(other[i], turns ? -end[i] : end[i], 1e-9) << name << " " << i;
    }
  }
}

// The loss by all of the initial state, spin included, against differences: of one width, or of two that are
// extrapolated, as that of a stiff force has its curvature. Published Jacobians are not meant as derivatives of the
// step.
TEST(SpinModels, GradientsAgreeWithDifferences) {
  Scene scene = Pair();
  scene.bodies[0].angular_velocity = 4;
  scene.steps = 240;
  for (const std::string& name : ModelsThatSpin(scene)) {
    if (FindContactModel(name)->published_jacobian) continue;
    SingleShooting shooting(MakeSimulator(name, scene, Precision::kDouble), SingleShooting::Variables::kInitialState);
    ASSERT_EQ(shooting.num_variables(), 12);
    std::vector<double> z = shooting.initial_guess(), gradient(z.size());
    double loss = 0;
    ASSERT_TRUE(shooting.Evaluate(z, &loss, gradient.data())) << name << ": " << shooting.FailureReason();
    for (std::size_t i = 0; i < z.size(); ++i) {
      const auto difference = [&](double width) {
        double losses[2];
        for (const int side : {0, 1}) {
          std::vector<double> moved = z;
          moved[i] += side == 0 ? -width : width;
          EXPECT_TRUE(shooting.Evaluate(moved, &losses[side], nullptr));
        }
        return (losses[1] - losses[0]) / (2 * width);
      };
      double error = HUGE_VAL, size = 1;
      for (const double width : {1e-6, 5e-6}) {
        const double wide = difference(width), extrapolated = (4 * difference(width / 2) - wide) / 3;
        error = std::min({error, std::abs(gradient[i] - wide), std::abs(gradient[i] - extrapolated)});
        size = std::max(1.0, std::abs(extrapolated));
        if (error <= 1e-6 * size) break;
      }
      EXPECT_LE(error, 1e-6 * size) << name << " " << i;
    }
  }
}

TEST(SpinModels, VelocityAndSpinAreVariables) {
  SingleShooting shooting(MakeSimulator("event", Pair(), Precision::kDouble));
  EXPECT_EQ(shooting.initial_guess(), (std::vector<double>{3, 0.5, -0.5, 0, -10}));
  const std::vector<double> initial = shooting.InitialStateAt(std::vector<double>{1, 2, 3, 4, 5});
  EXPECT_EQ(initial, (std::vector<double>{0, 0, 1, 2, 1, 0.25, 3, 4, 0, 20, 0, 5}));
}

// By powers of two: the same motion bit by bit.
TEST(SpinUnits, ChangeNoBit) {
  Scene scene = Pair();
  scene.bodies[0].inertia = {Inertia::Kind::kGiven, 0.0042};
  const std::vector<double> end = EndOf("event", scene);
  const ModelGradient gradient = ComputeGradient("event", scene, Precision::kDouble);
  for (const Rescaling& by : UnitRescalings()) {
    const Scene rescaled = Rescaled(scene, by);
    const std::vector<double> other = EndOf("event", rescaled);
    const double sizes[] = {by.length, by.length, by.speed(), by.speed(), 1, 1 / by.time};
    for (int i = 0; i < 12; ++i) EXPECT_EQ(other[i], end[i] * sizes[i % 6]) << by.name << " " << i;
    const ModelGradient moved = ComputeGradient("event", rescaled, Precision::kDouble);
    ASSERT_TRUE(moved.ok()) << moved.reason;
    EXPECT_EQ(moved.loss, gradient.loss * by.loss) << by.name;
    for (std::size_t i = 0; i < gradient.gradient.initial.size(); ++i) {
      const double size = i < 8 ? sizes[i % 4] : sizes[4 + i % 2];
      EXPECT_EQ(moved.gradient.initial[i], gradient.gradient.initial[i] * by.loss / size) << by.name << " " << i;
    }
    const double moment = by.mass * by.length * by.length;
    for (int i = 0; i < 2; ++i) {
      EXPECT_EQ(moved.gradient.parameters.inertia[i], gradient.gradient.parameters.inertia[i] * by.loss / moment);
    }
  }
}

TEST(SpinExactRun, IsTheRolloutWhateverTheIntervals) {
  Scene scene = Pair();
  scene.steps = 12;
  const std::vector<double> end = EndOf("event", scene);
  const ExactRun run = SimulateExactly(scene, InitialState(scene), {});
  ASSERT_TRUE(run.ok) << run.reason;
  EXPECT_EQ(run.end, ToInitial(end, 2));
  EXPECT_EQ(ToState(run.end, 2), end);
  const ExactRun parts = SimulateExactly(scene, InitialState(scene), {}, {0.1, 0.5, 0.6});
  ASSERT_TRUE(parts.ok) << parts.reason;
  for (std::size_t i = 0; i < run.end.size(); ++i) EXPECT_NEAR(parts.end[i], run.end[i], 1e-12) << i;
  EXPECT_NEAR(parts.loss, run.loss, 1e-12);
  const std::vector<double> short_of(8, 0.0);
  EXPECT_THAT(SimulateExactly(scene, short_of, {}).reason, HasSubstr("expected 12"));
}

TEST(SpinAudit, ExactGradientIsRightAndSpinCounts) {
  const Scene scene = Pair();
  const std::optional<ModelGradient> exact = ComputeExactGradient(scene);
  ASSERT_TRUE(exact);
  const ModelAudit audit = AuditModel("event", scene, Precision::kDouble, exact);
  EXPECT_EQ(audit.verdict, Verdict::kRight) << audit.VerdictReason();
  ModelGradient wrong = *exact;
  wrong.gradient.initial.back() += 1;
  EXPECT_GT(CompareGradients(wrong, *exact).relative, 1e-4);
  // Contacts along the normal are those without spin.
  const ContactRecognition recognised = RecogniseContact("xpbd", scene);
  EXPECT_EQ(recognised.contact_class, ContactClass::kProjection) << recognised.words;
  EXPECT_EQ(RecogniseContact("lcp_kkt", scene).contact_class, ContactClass::kImpulseAtStepBoundary);
  // Friction spins their discs, and those of the exact gradient too.
  EXPECT_EQ(ReasonNotComparable("compliant_brax", scene), "");
  const ModelAudit brax = AuditModel("compliant_brax", scene, Precision::kDouble, exact);
  ASSERT_TRUE(brax.gradient.ok()) << brax.gradient.reason;
  EXPECT_TRUE(IsWrong(brax.verdict)) << brax.VerdictReason();
}

// Task 2 with a ball that spins: one model of each class.
TEST(SpinAudit, ClassesAndVerdictsOfTaskTwo) {
  Scene scene = ProblemScene("ground_wall_spin");
  struct Expected {
    const char* contact;
    ContactClass contact_class;
    Verdict verdict;
  };
  const auto expect = [&](const Expected& expected) {
    const ModelAudit audit = AuditModel(expected.contact, scene, Precision::kDouble, ComputeExactGradient(scene));
    ASSERT_TRUE(audit.gradient.ok()) << expected.contact << ": " << audit.gradient.reason;
    ASSERT_TRUE(audit.recognition) << expected.contact;
    EXPECT_EQ(audit.recognition->contact_class, expected.contact_class) << expected.contact;
    EXPECT_EQ(audit.verdict, expected.verdict) << expected.contact;
  };
  expect({"event", ContactClass::kImpactTimeResolved, Verdict::kRight});
  expect({"qcqp", ContactClass::kImpulseAtStepBoundary, Verdict::kWrongSign});
  expect({"xpbd", ContactClass::kProjection, Verdict::kWrong});
  expect({"lcp_pgs", ContactClass::kDepthFeedback, Verdict::kWrongSign});
  expect({"compliant_warp", ContactClass::kForceWithJump, Verdict::kWrongSign});
  scene.contact.friction = 0;
  expect({"toi_velocity", ContactClass::kImpactTimeResolved, Verdict::kConsistent});
  expect({"position_qp", ContactClass::kNoRestitution, Verdict::kWrong});
}

// The optimal control is linear before the impact and after it; its integral from 0 to t.
Vec2d IntegralOfOptimum(double t) {
  const double s = SpinOptimum("time");
  const auto point = [](const char* key) { return Vec2d(SpinOptimum(key, 0), SpinOptimum(key, 1)); };
  const Vec2d start = point("force_0"), before = point("force_before"), after = point("force_after");
  const double early = std::min(t, s), late = std::max(t - s, 0.0);
  return early * start + 0.5 * early * early / s * (before - start) + (late - 0.5 * late * late / (1 - s)) * after;
}

// Its means over intervals that end at `ends`.
std::vector<double> MeansOfOptimum(const std::vector<double>& ends) {
  std::vector<double> control;
  double begin = 0;
  for (const double end : ends) {
    const Vec2d mean = (IntegralOfOptimum(end) - IntegralOfOptimum(begin)) / (end - begin);
    control.insert(control.end(), {mean[0], mean[1]});
    begin = end;
  }
  return control;
}

// The parts of the errors on task 2 with spin that come from steps: friction that is stiffer than the substeps, and
// iterations that have not converged, which the other descent on the same springs shows.
TEST(SpinAudit, SomeErrorsAreOfStepsAndIterations) {
  Scene scene = ProblemScene("ground_wall_spin");
  const auto gradient = [&](const std::string& contact) { return ComputeGradient(contact, scene, Precision::kDouble); };
  const auto error = [&](const std::string& contact) {
    return CompareGradients(gradient(contact), *ComputeExactGradient(scene)).relative;
  };
  EXPECT_GT(error("smooth_compliant"), 1);
  EXPECT_LT(error("smooth_compliant:slip_speed=0.1"), 0.06);
  EXPECT_LT(error("smooth_compliant:substeps=16"), 0.06);

  scene.steps = 72;
  EXPECT_THAT(gradient("primal_descent:implicit=0").reason, HasSubstr("do not converge"));
  const ModelGradient primal = gradient("primal_descent"), dual = gradient("dual_descent");
  ASSERT_TRUE(primal.ok() && dual.ok());
  EXPECT_LT(CompareGradients(primal, dual).relative, 1e-9);
  const ModelGradient iterated = gradient("primal_descent:implicit=0:iterations=1000");
  ASSERT_TRUE(iterated.ok());
  EXPECT_LT(CompareGradients(primal, iterated).relative, 1e-4);
}

// On intervals of which one ends at the impact, the loss is off by their length squared.
TEST(SpinOptimum, LossConvergesToTheExactOne) {
  const double s = SpinOptimum("time"), exact = SpinOptimum("loss");
  const auto loss_on = [&](int parts) {
    std::vector<double> ends, durations;
    for (int k = 1; k <= 2 * parts; ++k) {
      ends.push_back(k <= parts ? k * s / parts : s + (k - parts) * (1 - s) / parts);
      durations.push_back(k <= parts ? s / parts : (1 - s) / parts);
    }
    const Scene scene = SpinControl(2 * parts);
    const ExactRun run = SimulateExactly(scene, InitialState(scene), MeansOfOptimum(ends), durations);
    EXPECT_TRUE(run.ok) << run.reason;
    return run.loss;
  };
  const double coarse = loss_on(160), fine = loss_on(320), finest = loss_on(640);
  EXPECT_NEAR((coarse - exact) / (fine - exact), 4, 0.01);
  EXPECT_NEAR((fine - exact) / (finest - exact), 4, 0.01);
  EXPECT_NEAR(finest + (finest - fine) / 3, exact, 1e-9);
}

// On a grid whose step with the impact has one force before and after it, by its length. From the optimum's means: on
// the way there are kinks where the impact passes a node.
TEST(SpinOptimum, SolversConvergeToIt) {
  const double exact = SpinOptimum("loss");
  for (const char* solver : {"ceres_lm", "ceres_lbfgs", "gd"}) {
    for (const int steps : {60, 240}) {
      Scene scene = SpinControl(steps);
      std::vector<double> ends;
      for (int k = 1; k <= steps; ++k) ends.push_back(k * scene.dt());
      const ControlGuess guess{MeansOfOptimum(ends), {}};
      const SolveReport report =
          Solve(solver,
                {scene, "event"},
                {.limits = {.iterations = 100}, .descent = {.learning_rate = 0.02 * steps}, .guess = guess});
      ASSERT_FALSE(report.history.losses.empty()) << solver << ": " << report.reason;
      EXPECT_LE(report.solution.loss, report.guess.loss + 1e-12) << solver;
      EXPECT_GE(report.solution.loss, exact) << solver;
      EXPECT_LE(report.solution.loss, exact + 0.1 / steps) << solver << " " << steps;
    }
  }
}

TEST(SpinOptimum, FoundFromAwayBeatsWhatNeverTouchesTheWall) {
  for (const char* solver : {"ceres_lm", "ceres_lbfgs"}) {
    const SolveReport report = Solve(solver, {SpinControl(120), "event"}, {.limits = {.iterations = 300}});
    EXPECT_LT(report.solution.loss, 0.58) << solver;
    EXPECT_GE(report.solution.loss, SpinOptimum("loss")) << solver;
    EXPECT_LT(report.solution.loss, SpinOptimum("without_wall"));
  }
}

TEST(SpinProblem, BankShotNeedsSideSpin) {
  const Scene scene = ProblemScene("bank_shot");
  const SolveReport report = Solve("ceres_lm", {scene, "event"}, {.limits = {.iterations = 100}});
  ASSERT_EQ(report.termination, Termination::kConverged) << report.reason;
  const ExactRun shot = SimulateExactly(scene, report.solution.initial_state, {});
  // By the cushion, past the ball in the way, and into the corner.
  ASSERT_EQ(shot.events.size(), 2u);
  EXPECT_EQ(shot.events[0].b, "cushion");
  EXPECT_EQ(shot.events[1].b, "object");
  EXPECT_NEAR(shot.end[4], 0.95, 0.01);
  EXPECT_NEAR(shot.end[5], -0.35, 0.01);
  Scene plain = scene;
  plain.free_spin.clear();
  plain.bodies[0].angular_velocity = 0;
  plain.bodies[0].velocity = {1, 0.8};  // from where a shot without spin finds that way too
  const SolveReport without = Solve("ceres_lm", {plain, "event"}, {.limits = {.iterations = 100}});
  ASSERT_EQ(without.termination, Termination::kConverged) << without.reason;
  EXPECT_GT(without.solution.loss, 3 * report.solution.loss);
}

// Walls that end and a table, of discs that do not spin: all is at rest where it shall be.
TEST(EdgeProblem, CarromShotGoesThroughTheGate) {
  const Scene scene = ProblemScene("carrom_gate");
  const SolveReport report = Solve("ceres_lm", {scene, "event"}, {.limits = {.iterations = 100}});
  ASSERT_EQ(report.termination, Termination::kConverged) << report.reason;
  EXPECT_LT(report.solution.loss, 1e-3 * report.guess.loss);
  const ExactRun shot = SimulateExactly(scene, report.solution.initial_state, {});
  for (const Event& event : shot.events) EXPECT_TRUE(event.b.find("left") && event.b.find("right")) << event.b;
  for (const int entry : {2, 3, 6, 7}) EXPECT_EQ(shot.end[entry], 0) << entry;
  EXPECT_NEAR(shot.end[4], 0.65, 0.002);
  EXPECT_NEAR(shot.end[5], 0.25, 0.002);
  // On its way to the coin it is between the ends of the gate, by more than its radius.
  const double y = report.solution.initial_state[3] / report.solution.initial_state[2] * 0.22,
               radius = scene.bodies[0].radius;
  EXPECT_GT(y, 0.0 + radius);
  EXPECT_LT(y, 0.07 - radius);
}

// A shot that misses is mended until the coin falls in, where it has no slope to the rim's square of the radius.
TEST(EdgeProblem, CarromPotEndsInThePocket) {
  const Scene scene = ProblemScene("carrom_pot");
  const SolveReport report = Solve("ceres_lm", {scene, "event"}, {.limits = {.iterations = 100}});
  ASSERT_EQ(report.termination, Termination::kConverged) << report.reason;
  const double radius = scene.pockets[0].radius;
  EXPECT_GT(report.guess.loss, 100 * radius * radius);
  EXPECT_NEAR(report.solution.loss, radius * radius, 1e-12);
  const ExactRun shot = SimulateExactly(scene, report.solution.initial_state, {});
  const auto pocketed = [](const Event& event) { return event.mode == ContactMode::kPocketed; };
  ASSERT_EQ(std::count_if(shot.events.begin(), shot.events.end(), pocketed), 1);
  const Event& last = *std::find_if(shot.events.begin(), shot.events.end(), pocketed);
  EXPECT_EQ(last.a, "coin");
  EXPECT_EQ(last.b, "corner");
  EXPECT_NEAR(std::hypot(shot.end[4] - 0.36, shot.end[5] - 0.36), radius, 1e-12);
  for (const int entry : {6, 7}) EXPECT_EQ(shot.end[entry], 0);
  for (const char* solver : {"ceres_event", "ceres_phases", "hmp", "mode_search"}) {
    EXPECT_EQ(Solve(solver, {scene, "event"}, {}).termination, Termination::kNotApplicable) << solver;
  }
}

// Thrown away from the hand, it comes back to it: two solvers agree how. Without spin it cannot.
TEST(SpinProblem, BallComesBack) {
  const Scene scene = ProblemScene("back_spin");
  const SolveReport report = Solve("ceres_lm", {scene, "event"}, {.limits = {.iterations = 100}});
  const SolveReport other = Solve("ceres_lbfgs", {scene, "event"}, {.limits = {.iterations = 100}});
  ASSERT_EQ(report.termination, Termination::kConverged) << report.reason;
  EXPECT_NEAR(report.solution.loss, other.solution.loss, 1e-9);
  for (std::size_t i = 0; i < report.solution.initial_state.size(); ++i) {
    EXPECT_NEAR(report.solution.initial_state[i], other.solution.initial_state[i], 1e-6) << i;
  }
  EXPECT_GT(report.solution.initial_state[2], 0.5);
  const std::vector<double> end = SimulateExactly(scene, report.solution.initial_state, {}).end;
  EXPECT_LT(end[2], -1.4);
  EXPECT_NEAR(end[0], 0, 0.01);
  Scene plain = scene;
  plain.bodies[0].angular_velocity = 0;
  plain.free_spin.clear();
  EXPECT_GT(Solve("ceres_lm", {plain, "event"}, {.limits = {.iterations = 100}}).solution.loss,
            10 * report.solution.loss);
}

TEST(SpinSolvers, RefuseWhatTheyCannot) {
  const Scene scene = SpinControl(40);
  for (const char* solver : {"ceres_event", "hmp"}) {
    const SolveReport report = Solve(solver, {scene, "event"}, {});
    EXPECT_EQ(report.termination, Termination::kNotApplicable) << solver;
    EXPECT_THAT(report.reason, HasSubstr("spin")) << solver;
  }
  // Terms on the way are known to ceres_phases only.
  Scene on_the_way = scene;
  on_the_way.objective.running = {{.body = 0, .times = {0}, .targets = {{0, 0}}}};
  const SolveReport report = Solve("gd", {on_the_way, "event"}, {.limits = {.iterations = 3}});
  EXPECT_NE(report.termination, Termination::kConverged);
}

}  // namespace
}  // namespace saltus
