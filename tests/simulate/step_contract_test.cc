// Models that break their contract, and steps that do not arrive, fail and say which model, which step and what.
#include "simulate/step_contract.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "contact/models/direct.h"
#include "saltus/control/single_shooting.h"
#include "saltus/internal/contact_step.h"
#include "saltus/simulate/registry.h"
#include "test_scenes.h"

namespace saltus {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using testing::IsEmpty;

template <typename T>
using State = BodyState<T, 0>;

struct ForgetsReport : Direct<true> {
  template <typename T>
  void Step(const StepInput<T>& in, std::span<const State<T>> x, std::span<State<T>> next) const {
    StepInput<T> silent = in;
    silent.touches = nullptr;
    Direct<true>::Step(silent, x, next);
  }
};

// One contact of each step, however many there are.
struct ReportsTheFirst : Direct<true> {
  template <typename T>
  void Step(const StepInput<T>& in, std::span<const State<T>> x, std::span<State<T>> next) const {
    std::vector<Touch> touches;
    StepInput<T> own = in;
    own.touches = &touches;
    Direct<true>::Step(own, x, next);
    if (in.touches != nullptr && !touches.empty()) in.touches->push_back(touches[0]);
  }
};

struct ReportsAnything : Direct<true> {
  template <typename T>
  void Step(const StepInput<T>& in, std::span<const State<T>> x, std::span<State<T>> next) const {
    Direct<true>::Step(in, x, next);
    in.Report({0, 7, false});
  }
};

struct NeverArrives : Direct<true> {
  template <typename T>
  void Step(const StepInput<T>& in, std::span<const State<T>> x, std::span<State<T>> next) const {
    Direct<true>::Step(in, x, next);
    if (in.touches != nullptr && !in.touches->empty()) in.Fail("nothing converges");
  }
};

// Its speed falls by a part that grows with the speed.
struct HasQuadraticDrag : Direct<true> {
  template <typename T>
  State<T> Free(const StepInput<T>& in, int i, const State<T>& x) const {
    State<T> next = Direct<true>::Free(in, i, x);
    next.v -= Scale(T(Base<T>(0.01) * in.h * Length(x.v)), x.v);
    return next;
  }
};

// Discs lose speed to the ground where they hit each other.
template <bool kClaimsOtherwise>
struct BrakesAtImpacts : Direct<true> {
  static constexpr ModelTraits kTraits = {
      .name = "brakes", .summary = "", .source = "a test", .friction = false, .relative = kClaimsOtherwise};
  template <typename T>
  void Step(const StepInput<T>& in, std::span<const State<T>> x, std::span<State<T>> next) const {
    Direct<true>::Step(in, x, next);
    for (const Candidate& c : in.candidates) {
      const auto gap = SeparationAt(in, c, [&](int i) -> Vec2<T> { return x[i].p + Scale(in.h, x[i].v); }).distance -
                       in.ContactDistance(c);
      if (!(gap < Base<T>(0))) continue;
      for (const int disc : {c.a, c.b}) next[disc].v -= Scale(Base<T>(0.1), x[disc].v);
    }
  }
};

template <typename M, typename S = double>
std::string FailureReason(const Scene& scene) {
  const std::unique_ptr<Simulator> simulator = MakeModelSimulator<M, S>(scene);
  const bool ran = simulator->Rollout(InitialState(scene), InitialControl(scene, simulator->num_steps()));
  EXPECT_EQ(ran, simulator->FailureReason().empty());
  return simulator->FailureReason();
}

TEST(StepContract, IsKeptByAModelThatReports) {
  EXPECT_THAT(FailureReason<Direct<true>>(ProblemScene("two_balls")), IsEmpty());
  EXPECT_THAT((FailureReason<Direct<true>, float>(ProblemScene("two_balls"))), IsEmpty());
}

TEST(StepContract, AForgottenReportFailsTheRollout) {
  const auto says = AllOf(HasSubstr("step 331 of direct_toi"), HasSubstr("reports no contact"), HasSubstr("(striker)"));
  EXPECT_THAT(FailureReason<ForgetsReport>(ProblemScene("two_balls")), says);
  EXPECT_THAT((FailureReason<ForgetsReport, float>(ProblemScene("two_balls"))), HasSubstr("reports no contact"));
  EXPECT_THAT(FailureReason<ForgetsReport>(ProblemScene("bounce_once")), HasSubstr("reports no contact"));
}

TEST(StepContract, AForgottenReportGivesNoGradient) {
  SingleShooting shooting(MakeModelSimulator<ForgetsReport>(ProblemScene("two_balls")));
  std::vector<double> gradient(shooting.num_variables());
  double loss = 0;
  EXPECT_FALSE(shooting.Evaluate(shooting.initial_guess(), &loss, gradient.data()));
}

// With a step that fails behind it, a simulator goes on as if nothing had been.
TEST(StepContract, AFailureIsForgottenWithTheNextRollout) {
  Scene scene = ProblemScene("two_balls");
  const std::unique_ptr<Simulator> simulator = MakeModelSimulator<ForgetsReport>(scene);
  std::vector<double> control = InitialControl(scene, scene.steps);
  EXPECT_FALSE(simulator->Rollout(InitialState(scene), control));
  std::fill(control.begin(), control.end(), 0.0);
  EXPECT_TRUE(simulator->Rollout(InitialState(scene), control));
  EXPECT_THAT(simulator->FailureReason(), IsEmpty());
}

TEST(StepContract, OneOfTwoContactsIsNotEnough) {
  Scene scene;
  scene.duration = 0.25;
  scene.steps = 120;
  scene.bodies = {{.name = "a", .radius = 0.2, .position = {-0.5, 0}, .velocity = {3, 0}},
                  {.name = "b", .radius = 0.2, .position = {0.2, 0.25}},
                  {.name = "c", .radius = 0.2, .position = {0.2, -0.25}}};
  EXPECT_THAT(FailureReason<ReportsTheFirst>(scene), AllOf(HasSubstr("reports no contact"), HasSubstr("(c)")));
  EXPECT_THAT(FailureReason<Direct<true>>(scene), IsEmpty());
}

TEST(StepContract, AContactOfWhatThereIsNotIsRefused) {
  EXPECT_THAT(FailureReason<ReportsAnything>(ProblemScene("two_balls")), HasSubstr("is not among its candidates"));
}

TEST(StepContract, FreeFlightMustBeAffine) {
  EXPECT_THAT(FailureReason<HasQuadraticDrag>(ProblemScene("two_balls")), HasSubstr("not affine"));
}

TEST(StepContract, AStepThatFailsSaysWhich) {
  EXPECT_THAT(FailureReason<NeverArrives>(ProblemScene("two_balls")),
              HasSubstr("step 331 of direct_toi: nothing converges"));
}

TEST(StepContract, AStateThatIsNotFiniteSaysWhich) {
  Scene scene = ProblemScene("two_balls");
  std::vector<double> control = InitialControl(scene, scene.steps);
  control[2 * 17 + 1] = std::numeric_limits<double>::infinity();
  const auto simulator = MakeSimulator("direct_toi", scene, Precision::kDouble);
  EXPECT_FALSE(simulator->Rollout(InitialState(scene), control));
  EXPECT_EQ(simulator->FailureReason(), "step 17 of direct_toi: the state is not finite (striker)");
}

// A single step has no other way to say so.
TEST(StepContract, ASingleStepIsNotANumber) {
  Scene scene = ProblemScene("two_balls");
  scene.bodies[0].position = {-1.283, -1.283};
  scene.bodies[0].velocity = {2, 2};
  std::vector<double> next(8);
  const std::vector<double> force(4);
  const auto step = [&](const Simulator& simulator) {
    simulator.Step(InitialState(scene), force, next);
    return std::all_of(next.begin(), next.end(), [](double value) { return std::isfinite(value); });
  };
  EXPECT_TRUE(step(*MakeModelSimulator<Direct<true>>(scene)));
  EXPECT_FALSE(step(*MakeModelSimulator<ForgetsReport>(scene)));
  EXPECT_FALSE(step(*MakeModelSimulator<NeverArrives>(scene)));
  EXPECT_FALSE(step(*MakeModelSimulator<ReportsAnything>(scene)));
}

// Who says nothing of relative motion has the right gradient, whatever the model does.
TEST(StepContract, RelativeMotionIsNotTakenForGranted) {
  static_assert(!ModelTraits{}.relative);
  const auto miss = [](auto model) {
    const Scene scene = ProblemScene("two_balls");
    SingleShooting shooting(MakeModelSimulator<decltype(model)>(scene), SingleShooting::Variables::kInitialState);
    std::vector<double> z = shooting.initial_guess(), gradient(z.size());
    double loss = 0, most = 0;
    EXPECT_TRUE(shooting.Evaluate(z, &loss, gradient.data()));
    for (size_t i = 0; i < z.size(); ++i) {
      const auto at = [&](double shift) {
        std::vector<double> moved = z;
        moved[i] += shift;
        double value = 0;
        EXPECT_TRUE(shooting.Evaluate(moved, &value, nullptr));
        return value;
      };
      most = std::max(most, std::abs(gradient[i] - (at(1e-6) - at(-1e-6)) / 2e-6));
    }
    return most;
  };
  EXPECT_LT(miss(BrakesAtImpacts<false>()), 1e-7);
  EXPECT_GT(miss(BrakesAtImpacts<true>()), 1e-3);
}

}  // namespace
}  // namespace saltus
