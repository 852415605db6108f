// Whatever the scene, every public function that takes one says what is wrong with it, and touches nothing it must not.
#include "broken_scenes.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "audit/gradient/step_study.h"
#include "exact/closed_forms.h"
#include "exact/two_disc_optimum.h"
#include "saltus/audit/audit.h"
#include "saltus/control/objective.h"
#include "saltus/optimality/certificate.h"
#include "saltus/simulate/exact_run.h"
#include "saltus/simulate/registry.h"
#include "saltus/solve/solver.h"

namespace saltus {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using testing::IsEmpty;

// The key, and not the beginning of another.
auto Names(const BrokenScene& broken) { return HasSubstr(broken.key + ": "); }

TEST(BrokenScenes, AreOnlyBrokenWhereTheyAre) {
  EXPECT_FALSE(ValidateStructure(SceneToBreak()));
  EXPECT_FALSE(Validate(SceneToBreak()));
  for (const BrokenScene& broken : BrokenScenes()) {
    ASSERT_TRUE(ValidateStructure(broken.scene)) << broken.key;
    EXPECT_EQ(ValidateStructure(broken.scene)->key, broken.key);
    EXPECT_EQ(Validate(broken.scene)->key, broken.key);
  }
}

// Names, overlaps and what is to be optimised are no matter of a simulation.
TEST(BrokenScenes, AScenePartsOfWhichAreMissingCanBeSimulated) {
  Scene scene = SceneToBreak();
  for (Body& body : scene.bodies) body.name.clear();
  scene.name.clear();
  scene.objective.terminal.clear();
  scene.bodies[1].position = scene.bodies[0].position + Vec2d(0.1, 0);
  EXPECT_TRUE(Validate(scene));
  EXPECT_FALSE(ValidateStructure(scene));
  EXPECT_THAT(ReasonNotApplicable("direct_toi", scene), IsEmpty());
}

TEST(BrokenScenes, NoModelTakesThem) {
  for (const BrokenScene& broken : BrokenScenes()) {
    for (const ModelTraits& model : AllContactModels()) {
      EXPECT_THAT(ReasonNotApplicable(model.name, broken.scene), Names(broken)) << model.name;
      EXPECT_THAT(ComputeGradient(model.name, broken.scene, Precision::kDouble).reason, Names(broken));
    }
  }
}

TEST(BrokenScenes, NoSolverTakesThem) {
  for (const BrokenScene& broken : BrokenScenes()) {
    for (const Optimize optimize : {Optimize::kControl, Optimize::kVelocity, Optimize::kPosition, Optimize::kNone}) {
      SolveRequest request{.scene = broken.scene, .contact = "event"};
      request.scene.optimize = optimize;
      for (const SolverEntry& solver : AllSolvers()) {
        const SolveReport report = Solve(solver.name, request, {.limits = {.iterations = 2}});
        EXPECT_EQ(report.termination, Termination::kNotApplicable) << solver.name << " " << broken.key;
        EXPECT_THAT(report.reason, Names(broken)) << solver.name;
      }
    }
  }
}

TEST(BrokenScenes, NoAuditTakesThem) {
  for (const BrokenScene& broken : BrokenScenes()) {
    const Scene& scene = broken.scene;
    EXPECT_FALSE(ComputeExactGradient(scene)) << broken.key;
    const ModelAudit audit = AuditModel("direct_toi", scene, Precision::kDouble, std::nullopt, {.width_sweep = true});
    EXPECT_THAT(audit.gradient.reason, Names(broken));
    EXPECT_THAT(audit.VerdictReason(), IsEmpty());
    EXPECT_THAT(ComputeSurrogate("direct_toi", scene, Precision::kDouble, {}).reason, Names(broken));
    EXPECT_THAT(StudyRefinement("direct_toi", scene).reason, Names(broken));
    EXPECT_THAT(AttributeError("direct_toi", scene).reason, Names(broken));
    EXPECT_THAT(RecogniseContact("direct_toi", scene).words, Names(broken));
    EXPECT_THAT(SweepWidths("direct_toi", scene).reason, Names(broken));
    EXPECT_FALSE(MeasureConditioning(scene));
    EXPECT_EQ(CheckGradient("direct_toi", scene).agreement, Agreement::kUndecided);
  }
}

TEST(BrokenScenes, NothingExactTakesThem) {
  for (const BrokenScene& broken : BrokenScenes()) {
    const Scene& scene = broken.scene;
    const std::vector<double> initial = InitialState(scene);
    std::vector<double> control(2 * scene.control.bodies.size() * 4, 1.0);
    EXPECT_THAT(SimulateExactly(scene, initial, control).reason, Names(broken));
    Scene optimized = scene;
    optimized.optimize = Optimize::kControl;
    const Certificate certificate = Certify(optimized, initial, control);
    EXPECT_EQ(certificate.verdict, Certificate::Verdict::kNotApplicable) << broken.key;
    std::string reason_not_applicable;
    EXPECT_FALSE(EvaluateClosedForm(scene, &reason_not_applicable));
    EXPECT_THAT(reason_not_applicable, Names(broken));
    EXPECT_FALSE(FindTwoDiscOptimum(scene, TwoDiscSequence::kImpact, &reason_not_applicable));
    EXPECT_THAT(reason_not_applicable, Names(broken));
    EXPECT_FALSE(FindGridOptimum(scene, TwoDiscSequence::kImpactThenPlane, &reason_not_applicable));
    EXPECT_THAT(reason_not_applicable, Names(broken));
    EXPECT_FALSE(OptimizeWithImpactAt(scene, TwoDiscSequence::kImpact, 3, &reason_not_applicable));
    EXPECT_THAT(FindLaunchSolutions(scene, 1, &reason_not_applicable), IsEmpty());
    EXPECT_THAT(reason_not_applicable, Names(broken));
  }
}

TEST(BrokenScenesDeathTest, ASimulatorIsNotMadeOfThem) {
  testing::FLAGS_gtest_death_test_style = "threadsafe";
  Scene scene = SceneToBreak();
  scene.objective.terminal[0].body = 40;
  EXPECT_DEATH(MakeSimulator("direct_toi", scene, Precision::kDouble), "objective.terminal.0..body: found");
  EXPECT_DEATH(MakeSimulator("nonsense", SceneToBreak(), Precision::kDouble), "found 'nonsense', expected a contact");
}

// ---------------------------------------------------------------------------------------------------------------------
// Scenes that are right, and all else that may be wrong.

TEST(WrongArguments, UnknownNamesAreSaidSo) {
  const Scene scene = SceneToBreak();
  const auto unknown = AllOf(HasSubstr("found 'nonsense', expected a contact model"), HasSubstr("direct_toi"));
  EXPECT_THAT(ReasonNotApplicable("nonsense", scene), unknown);
  EXPECT_THAT(ReasonNotApplicable("ncp:kapa=1", scene), HasSubstr("found 'kapa'"));
  EXPECT_THAT(ReasonNotApplicable("ncp:kappa=-1", scene), HasSubstr("expected kappa= and a number"));
  EXPECT_THAT(ComputeGradient("nonsense", scene, Precision::kDouble).reason, unknown);
  EXPECT_THAT(ComputeSurrogate("nonsense", scene, Precision::kDouble, {}).reason, unknown);
  EXPECT_THAT(AuditModel("nonsense", scene, Precision::kDouble, std::nullopt).gradient.reason, unknown);
  EXPECT_THAT(StudyRefinement("nonsense", scene).reason, unknown);
  EXPECT_THAT(AttributeError("nonsense", scene).reason, unknown);
  EXPECT_THAT(RecogniseContact("nonsense", scene).words, unknown);
  EXPECT_THAT(SweepWidths("nonsense", scene).reason, unknown);
  EXPECT_THAT(Solve("gd", {.scene = scene, .contact = "nonsense"}, {}).reason, unknown);
  EXPECT_THAT(ReasonNotApplicable(Surrogate{.kind = SurrogateKind::kComplementarityAware}, "nonsense", scene), unknown);
  const SolveReport report = Solve("nonsense", {.scene = scene, .contact = "event"}, {});
  EXPECT_EQ(report.termination, Termination::kNotApplicable);
  EXPECT_THAT(report.reason, AllOf(HasSubstr("solver: found 'nonsense', expected a solver"), HasSubstr("ceres_lm")));
}

TEST(WrongArguments, OptionsOfSolversAreSaidSo) {
  const SolveRequest request{.scene = SceneToBreak(), .contact = "event"};
  const auto reason = [&](const SolverOptions& options) { return Solve("gd", request, options).reason; };
  EXPECT_THAT(reason({.limits = {.iterations = -1}}), HasSubstr("iterations: found -1"));
  EXPECT_THAT(reason({.descent = {.learning_rate = std::numeric_limits<double>::quiet_NaN()}}),
              HasSubstr("learning_rate"));
  EXPECT_THAT(reason({.surrogate = Surrogate{.sigma = -1}}), HasSubstr("sigma"));
  EXPECT_THAT(reason({.threads = -3}), HasSubstr("threads: found -3"));
  for (const Candidate& pair : {Candidate{0, 40, false},
                                Candidate{-1, 1, false},
                                Candidate{0, 0, false},
                                Candidate{0, 2, true},
                                Candidate{1, 0, false}}) {
    SolverOptions options;
    options.sequences.given = ContactSequence{pair};
    for (const SolverEntry& solver : AllSolvers()) {
      EXPECT_THAT(Solve(solver.name, request, options).reason, HasSubstr("sequence: found the pair")) << solver.name;
    }
  }
}

TEST(WrongArguments, ShapesOfAnExactRunAreSaidSo) {
  const Scene scene = SceneToBreak();
  const std::vector<double> initial = InitialState(scene), control(2 * 8, 1.0), durations(8, 0.125);
  ASSERT_TRUE(SimulateExactly(scene, initial, control, durations).ok);
  const auto reason = [&](const std::vector<double>& x, const std::vector<double>& u, const std::vector<double>& h) {
    const Certificate certificate = Certify(scene, x, u, h);
    EXPECT_EQ(certificate.verdict, Certificate::Verdict::kNotApplicable);
    const std::string found = SimulateExactly(scene, x, u, h).reason;
    EXPECT_EQ(certificate.reason, found);
    return found;
  };
  const double nan = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THAT(reason({1, 2, 3}, control, {}), HasSubstr("initial state: found 3 numbers, expected 8"));
  EXPECT_THAT(reason({}, control, {}), HasSubstr("initial state: found 0 numbers"));
  EXPECT_THAT(reason(initial, {}, {}), HasSubstr("control: found 0 numbers"));
  EXPECT_THAT(reason(initial, std::vector<double>(7, 1.0), {}), HasSubstr("control: found 7 numbers"));
  EXPECT_THAT(reason(initial, control, {0.5, 0.5}), HasSubstr("control: found 16 numbers, expected 4"));
  EXPECT_THAT(reason(initial, std::vector<double>(16, nan), {}), HasSubstr("control: expected finite"));
  EXPECT_THAT(reason(std::vector<double>(8, nan), control, {}), HasSubstr("initial state: expected finite"));
  EXPECT_THAT(reason(initial, control, std::vector<double>(8, -0.125)), HasSubstr("durations"));
  EXPECT_THAT(reason(initial, control, std::vector<double>(8, nan)), HasSubstr("durations"));
  EXPECT_THAT(reason(initial, control, std::vector<double>(8, 0.12)), HasSubstr("found a sum of 0.96"));
  Scene unpushed = scene;
  unpushed.control = {};
  EXPECT_THAT(SimulateExactly(unpushed, initial, control).reason, HasSubstr("nothing is pushed"));
}

// An interval without length changes nothing.
TEST(WrongArguments, AnIntervalWithoutLengthIsNone) {
  const Scene scene = SceneToBreak();
  std::vector<double> control(2 * 8, 1.0), durations(8, 0.125);
  const double loss = SimulateExactly(scene, InitialState(scene), control, durations).loss;
  control.insert(control.begin() + 6, {1e3, 1e3});
  durations.insert(durations.begin() + 3, 0.0);
  const ExactRun run = SimulateExactly(scene, InitialState(scene), control, durations);
  EXPECT_TRUE(run.ok) << run.reason;
  EXPECT_NEAR(run.loss, loss, 1e-12 * loss);
}

TEST(WrongArgumentsDeathTest, SizesOfASimulatorAreChecked) {
  testing::FLAGS_gtest_death_test_style = "threadsafe";
  const auto simulator = MakeSimulator("direct_toi", SceneToBreak(), Precision::kDouble);
  const std::vector<double> initial = InitialState(simulator->scene()), control(simulator->control_size()), force(4);
  std::vector<double> x(8), few(7);
  ASSERT_TRUE(simulator->Rollout(initial, control));
  EXPECT_DEATH(simulator->Rollout(few, control), "Check failed");
  EXPECT_DEATH(simulator->Rollout(initial, few), "Check failed");
  EXPECT_DEATH(simulator->GetState(simulator->num_steps() + 1, x), "Check failed");
  EXPECT_DEATH(simulator->GetState(-1, x), "Check failed");
  EXPECT_DEATH(simulator->GetState(0, few), "Check failed");
  EXPECT_DEATH(simulator->Step(x, force, few), "Check failed");
  EXPECT_DEATH(simulator->Step(few, force, x), "Check failed");
  EXPECT_DEATH(simulator->ExpandInitial(few, x), "Check failed");
  EXPECT_DEATH(simulator->ExpandForce(control, simulator->num_steps(), few), "Check failed");
  EXPECT_DEATH(TerminalLoss({.terminal = {{.body = 40}}}, x, 4), "Check failed");
}

}  // namespace
}  // namespace saltus
