// Every contact model of the registry against what all of them must do; and the checks against seeded faults.
#include "simulate/conformance.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <type_traits>

#include "contact/models/compliant_warp.h"
#include "contact/models/direct.h"
#include "contact/models/lcp_pgs.h"
#include "contact/models/pbd_warp.h"
#include "saltus/internal/contact_step.h"
#include "saltus/simulate/registry.h"
#include "simulate/conformance_derivatives.h"
#include "test_scenes.h"

extern template class saltus::ContactStepOf<saltus::CompliantWarp, double>;
extern template class saltus::ContactStepOf<saltus::Direct<true>, double>;
extern template class saltus::ContactStepOf<saltus::LcpPgs<false>, double>;
extern template class saltus::ContactStepOf<saltus::PbdWarp, double>;

namespace saltus::conformance {
namespace {

using testing::IsEmpty;
using testing::Not;

class EveryModel : public testing::TestWithParam<std::string> {
 protected:
  Model model() const {
    const std::string name = GetParam();
    return {*FindContactModel(name),
            [name](const Scene& scene) { return MakeSimulator(name, scene, Precision::kDouble); },
            [name](const Scene& scene) { return ReasonNotApplicable(name, scene); }};
  }
  // Several discs, a fixed one and two planes; with friction if the model knows it.
  std::vector<Scene> Scenes() const {
    std::vector<Scene> scenes = {FourDiscs(0)};
    if (model().traits.friction) scenes.push_back(FourDiscs(0.3));
    if (std::isfinite(model().traits.push_gap)) return scenes;
    for (Scene& scene : scenes) {  // every step has a system of equations, and all discs in it
      scene.steps = 30;
      scene.duration *= 0.2;
    }
    return scenes;
  }
};

TEST_P(EveryModel, FliesFreely) { EXPECT_THAT(CheckFreeFlight(model()), IsEmpty()); }
TEST_P(EveryModel, IgnoresNeighboursThatDoNotTouch) { EXPECT_THAT(CheckNeighbours(model()), IsEmpty()); }
TEST_P(EveryModel, ConservesMomentum) { EXPECT_THAT(CheckMomentum(model()), IsEmpty()); }
TEST_P(EveryModel, HasItsRestitution) { EXPECT_THAT(CheckRestitution(model()), IsEmpty()); }
TEST_P(EveryModel, SeparatesBodies) { EXPECT_THAT(CheckSeparation(model()), IsEmpty()); }
TEST_P(EveryModel, LeavesNoOverlap) { EXPECT_THAT(CheckOverlap(model()), IsEmpty()); }
TEST_P(EveryModel, MovesOverlappingBodiesApart) { EXPECT_THAT(CheckProjection(model()), IsEmpty()); }
TEST_P(EveryModel, HasFrictionWithinItsBound) { EXPECT_THAT(CheckFriction(model()), IsEmpty()); }
TEST_P(EveryModel, LeavesFixedDiscsInPlace) { EXPECT_THAT(CheckFixedDiscs(model()), IsEmpty()); }
TEST_P(EveryModel, ResolvesSeveralContactsAtOnce) { EXPECT_THAT(CheckSeveralAtOnce(model()), IsEmpty()); }
TEST_P(EveryModel, IsFiniteInDegenerateStates) { EXPECT_THAT(CheckDegenerateStates(model()), IsEmpty()); }
TEST_P(EveryModel, KeepsGroupsApart) { EXPECT_THAT(CheckGroupsApart(model()), IsEmpty()); }
TEST_P(EveryModel, LinearizesItsStep) {
  for (const Scene& scene : Scenes()) EXPECT_THAT(CheckDerivative(model(), scene), IsEmpty());
}
TEST_P(EveryModel, IsSymmetric) {
  for (const Scene& scene : Scenes()) EXPECT_THAT(CheckSymmetries(model(), scene), IsEmpty());
}
TEST_P(EveryModel, IsDeterministic) {
  for (const Scene& scene : Scenes()) EXPECT_THAT(CheckDeterminism(model(), scene), IsEmpty());
}

std::vector<std::string> AllNames() {
  std::vector<std::string> names;
  for (const ModelTraits& model : AllContactModels()) names.emplace_back(model.name);
  return names;
}

std::string NameOf(const testing::TestParamInfo<std::string>& info) { return info.param; }

INSTANTIATE_TEST_SUITE_P(Registry, EveryModel, testing::ValuesIn(AllNames()), NameOf);

// ---------------------------------------------------------------------------------------------------------------------
// Seeded faults, in steps that the library has.

template <ContactModel M, typename T, typename State = BodyState<T, M::kRotation>>
void StepOf(const StepInput<T>& in, std::span<const State> x, std::span<State> next) {
  const ContactStep<double, M::kRotation>& step = ContactStepOf<M, double>(M());
  step.Step(in, x, next);
}

struct ForgetsRestitution : Direct<true> {
  template <typename T>
  void Step(const StepInput<T>& in, std::span<const State<T>> x, std::span<State<T>> next) const {
    StepInput<T> plastic = in;
    plastic.contact.restitution = T(Base<T>(0));
    StepOf<Direct<true>>(plastic, x, next);
  }
};

// By one percent of the speed: two of the stiffness.
struct PartsStiffer : CompliantWarp {
  template <typename T>
  void Step(const StepInput<T>& in, std::span<const State<T>> x, std::span<State<T>> next) const {
    StepInput<T> stiffer = in;
    const Candidate& c = in.candidates[0];
    const Vec2<T> normal = SeparationAt(in, c, [&](int i) -> const Vec2<T>& { return x[i].p; }).normal;
    const T speed = Dot(normal, RelativeVelocity<T>(c, [&](int i) -> Vec2<T> { return x[i].v; }));
    if (speed > Base<T>(0)) stiffer.contact.stiffness = in.contact.stiffness * Base<T>(1.02);
    StepOf<CompliantWarp>(stiffer, x, next);
  }
};

// Twice as much of an overlap as stated.
LcpPgs<false> CorrectsTwice() {
  LcpPgs<false> model;
  model.erp *= 2;
  return model;
}

struct FlipsTheNormal : Direct<true> {
  template <typename T>
  void Step(const StepInput<T>& in, std::span<const State<T>> x, std::span<State<T>> next) const {
    using S = Base<T>;
    StepOf<Direct<true>>(in, x, next);
    for (std::size_t i = 0; i < x.size(); ++i) {
      const State<T> flying = Free(in, static_cast<int>(i), x[i]);
      next[i].p = Scale(S(2), flying.p) - next[i].p;
      next[i].v = Scale(S(2), flying.v) - next[i].v;
    }
  }
};

// Values of the impact within the step, derivatives of the impact at its end.
struct OtherBranchInJets : Direct<true> {
  template <typename T>
  void Step(const StepInput<T>& in, std::span<const State<T>> x, std::span<State<T>> next) const {
    if constexpr (std::is_same_v<T, Base<T>>) {
      StepOf<Direct<true>>(in, x, next);
    } else {
      Direct<false>().Step(in, x, next);
    }
  }
};

struct PushesOneSideOnly : Direct<true> {
  template <typename T>
  void Step(const StepInput<T>& in, std::span<const State<T>> x, std::span<State<T>> next) const {
    StepOf<Direct<true>>(in, x, next);
    for (const Candidate& c : in.candidates) {
      if (!c.plane) next[c.b] = Free(in, c.b, x[c.b]);
    }
  }
};

struct ForgetsThePosition : PbdWarp {
  template <typename T>
  void Step(const StepInput<T>& in, std::span<const State<T>> x, std::span<State<T>> next) const {
    StepOf<PbdWarp>(in, x, next);
    for (std::size_t i = 0; i < x.size(); ++i) next[i].p = Free(in, static_cast<int>(i), x[i]).p;
  }
};

template <ContactModel M>
Model Tested(const M& model = {}) {
  return {M::kTraits,
          [model](const Scene& scene) { return MakeModelSimulator(scene, Precision::kDouble, model); },
          [](const Scene&) { return std::string(); }};
}

TEST(SeededFault, ForgottenRestitutionIsFound) {
  EXPECT_THAT(CheckRestitution(Tested<ForgetsRestitution>()), Not(IsEmpty()));
}

TEST(SeededFault, EnergyFromNothingIsFound) {
  EXPECT_THAT(CheckRestitution(Tested<CompliantWarp>()), IsEmpty());
  EXPECT_THAT(CheckRestitution(Tested<PartsStiffer>()), Not(IsEmpty()));
  EXPECT_THAT(CheckRestitution(Tested(CorrectsTwice())), Not(IsEmpty()));
}

TEST(SeededFault, FlippedNormalIsFound) {
  EXPECT_THAT(CheckSeparation(Tested<FlipsTheNormal>()), Not(IsEmpty()));
  EXPECT_THAT(CheckOverlap(Tested<FlipsTheNormal>()), Not(IsEmpty()));
}

TEST(SeededFault, OtherBranchInJetsIsFound) {
  EXPECT_THAT(CheckDerivative(Tested<OtherBranchInJets>(), FourDiscs(0)), Not(IsEmpty()));
}

TEST(SeededFault, LostMomentumIsFound) {
  EXPECT_THAT(CheckMomentum(Tested<PushesOneSideOnly>()), Not(IsEmpty()));
  EXPECT_THAT(CheckSeveralAtOnce(Tested<PushesOneSideOnly>()), Not(IsEmpty()));
}

TEST(SeededFault, ForgottenPositionIsFound) {
  EXPECT_THAT(CheckProjection(Tested<ForgetsThePosition>()), Not(IsEmpty()));
}

}  // namespace
}  // namespace saltus::conformance
