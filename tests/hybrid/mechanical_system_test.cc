// Impacts, closed contacts and what is reported where a motion or its derivative does not exist.
#include "saltus/hybrid/mechanical_system.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "hybrid/mechanical_problems.h"
#include "problems/hybrid_systems.h"
#include "reference_values.h"

namespace saltus {
namespace {

using nlohmann::json;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;

constexpr double kClosedForm = 1e-12;  // relative

const json& ClosedForms() { return ReferenceFile("mechanical_references.json").at("closed_forms"); }

// ---------------------------------------------------------------------------------------------------------------------
// One vertex against a plane.

struct VertexImpact {
  VertexImpact(const std::string& name, MechanicalOptions options) : system(Vertex(), options) {
    std::vector<double> data;  // m, I, rx, ry, vx, vy, w, e, mu
    for (const json& value : ClosedForms().at(name).at("data")) data.push_back(Number(value));
    p = {data[0], data[1], data[2], data[3], data[7], data[8]};
    x = {0, -data[3], 0, data[4], data[5], data[6]};
    impact = system.ImpactAt(system.Mode("o"), 0, x, {}, p);
  }
  void Expect(const json& expected) {
    ASSERT_EQ(impact.contacts.size(), 1u);
    const MechanicalImpact::Contact& contact = impact.contacts[0];
    const auto near = [](double found, const json& value, const char* what) {
      EXPECT_NEAR(found, Number(value), kClosedForm * std::max(1.0, std::abs(found))) << what;
    };
    near(contact.normal_impulse, expected.at("pn"), "pn");
    near(contact.tangential_impulse, expected.at("pt"), "pt");
    near(impact.energy, expected.at("dE"), "dE");
    const auto mode = expected.value("mode", std::string());
    if (!mode.empty()) {
      EXPECT_EQ(contact.status, mode == "stick" ? 's' : mode.back());
    }
    std::vector<double> after(6);
    system.hybrid().functions().Reset({system.Mode("o"), 0, x.data(), nullptr, p.data()}, 0, after.data());
    for (int i = 0; i < 3; ++i) near(after[3 + i], expected.at("v")[i], "v");
  }

  MechanicalSystem system;
  std::vector<double> p, x;
  MechanicalImpact impact;
};

TEST(VertexImpact, HasTheClosedFormAndItsDerivatives) {
  for (const char* name : {"P8_slip", "P8_stick", "P8_back"}) {
    SCOPED_TRACE(name);
    const json& expected = ClosedForms().at(name);
    VertexImpact newton(name, {});
    newton.Expect(expected);
    std::vector<double> after(6), jacobian(6 * 13);
    newton.system.hybrid().functions().ResetJacobian(
        {0, 0, newton.x.data(), nullptr, newton.p.data()}, 0, after.data(), jacobian.data());
    const std::vector<std::pair<const char*, int>> columns = {
        {"vx", 3}, {"vy", 4}, {"w", 5}, {"m", 7}, {"I", 8}, {"rx", 9}, {"ry", 10}, {"e", 11}, {"mu", 12}};
    for (const auto& [by, column] : columns) {
      for (int i = 0; i < 3; ++i) {
        const double value = Number(expected.at("grad").at(by)[i]);
        EXPECT_NEAR(jacobian[(3 + i) * 13 + column], value, kClosedForm * std::max(1.0, std::abs(value)))
            << "v" << i << " by " << by;
      }
    }
  }
}

TEST(VertexImpact, NewtonsLawCanGainEnergyWhichIsReported) {
  VertexImpact newton("P8_kane", {});
  newton.Expect(ClosedForms().at("P8_kane").at("newton"));
  EXPECT_GT(newton.impact.energy, 0.05);
  VertexImpact("P8_kane2", {}).Expect(ClosedForms().at("P8_kane2").at("newton"));
  // In a motion.
  HybridSimulator simulator(newton.system.hybrid());
  std::vector<double> x = newton.x;
  x[1] += 0.1;
  const HybridInput input{.initial = x, .parameters = newton.p, .duration = 0.2};
  ASSERT_TRUE(simulator.Rollout(input)) << simulator.FailureReason();
  const MechanicalReport report = newton.system.Examine(simulator, input);
  EXPECT_THAT(report.energy_gains, ElementsAre(0));
  EXPECT_NEAR(report.largest_gain, 0.0569696969696969697, 1e-11);
}

TEST(VertexImpact, PoissonsLaw) {
  const MechanicalOptions poisson{.law = MechanicalOptions::Law::kPoisson};
  for (const char* name : {"P8_kane", "P8_kane2"}) {
    VertexImpact impact(name, poisson);
    const json& expected = ClosedForms().at(name).at("poisson");
    impact.Expect(expected);
    const MechanicalImpact::Contact& contact = impact.impact.contacts[0];
    EXPECT_NEAR(-contact.normal_after / contact.normal_before, Number(expected.at("ratio")), kClosedForm);
    // Derivatives against differences of fourth order.
    const HybridFunctions& f = impact.system.hybrid().functions();
    std::vector<double> after(6), jacobian(6 * 13);
    f.ResetJacobian({0, 0, impact.x.data(), nullptr, impact.p.data()}, 0, after.data(), jacobian.data());
    for (int column = 0; column < 13; ++column) {
      if (column == 6) continue;  // time
      const auto at = [&](double step) {
        std::vector<double> x = impact.x, p = impact.p, out(6);
        (column < 6 ? x[column] : p[column - 7]) += step;
        f.Reset({0, 0, x.data(), nullptr, p.data()}, 0, out.data());
        return out;
      };
      const double h = 1e-3;
      const std::vector<double> far_on = at(2 * h), on = at(h), back = at(-h), far_back = at(-2 * h);
      for (int i = 0; i < 6; ++i) {
        const double difference = (8 * (on[i] - back[i]) - (far_on[i] - far_back[i])) / (12 * h);
        EXPECT_NEAR(jacobian[i * 13 + column], difference, 1e-7 * std::max(1.0, std::abs(difference)))
            << name << " " << i << " by " << column;
      }
    }
  }
}

// ---------------------------------------------------------------------------------------------------------------------
// Several contacts.

// Parameters of Box: m a b g e mu beta th0.
TEST(SeveralContacts, TwoCornersThatHitAtOnceAreReported) {
  const MechanicalSystem system{Box<2>()};
  HybridSimulator simulator(system.hybrid());
  const HybridInput input{
      .initial = {0, 0.5, 0, 0, -1, 0}, .parameters = {1, 0.3, 0.2, 0, 0.5, 0, 0, 0}, .duration = 0.4};
  ASSERT_TRUE(simulator.Rollout(input)) << simulator.FailureReason();
  EXPECT_THAT(simulator.ReasonNotDifferentiable(), HasSubstr("hit at the same instant and are coupled (simultaneous)"));
  const MechanicalReport report = system.Examine(simulator, input);
  ASSERT_EQ(report.impacts.size(), 1u);
  const MechanicalImpact& impact = report.impacts[0];
  EXPECT_TRUE(impact.simultaneous);
  EXPECT_NEAR(impact.time, 0.3, 1e-14);
  ASSERT_EQ(impact.contacts.size(), 2u);
  for (const MechanicalImpact::Contact& contact : impact.contacts) EXPECT_NEAR(contact.normal_impulse, 0.75, 1e-14);
  EXPECT_NEAR(impact.coupling, 7.0 / 20, 1e-14);
  EXPECT_NEAR(impact.v_simultaneous[1], 0.5, 1e-14);
  EXPECT_NEAR(impact.v_simultaneous[2], 0, 1e-14);
  EXPECT_NEAR(impact.v_first_then_second[1], 0.3774921875, 1e-14);
  EXPECT_NEAR(impact.v_first_then_second[2], 0.757265625, 1e-14);
  EXPECT_NEAR(impact.v_second_then_first[1], 0.3774921875, 1e-14);
  EXPECT_NEAR(impact.v_second_then_first[2], -0.757265625, 1e-14);
}

TEST(SeveralContacts, ForcesOfABoxThatSlidesAreUnique) {
  const MechanicalSystem system{Box<2>()};
  const std::vector<double> x = {0, 0.2, 0, 0.5, 0, 0}, p = {2, 0.3, 0.2, 9.81, 0, 0.3, 0.4, 0};
  const MechanicalSystem::Motion motion = system.MotionIn(system.Mode("++"), x, {}, p);
  const json& expected = ClosedForms().at("P5s");
  EXPECT_NEAR(motion.acceleration[0], Number(expected.at("acc")), 1e-13);
  EXPECT_NEAR(motion.normal[0], Number(expected.at("N_A")), 1e-12);
  EXPECT_NEAR(motion.normal[1], Number(expected.at("N_B")), 1e-12);
}

TEST(SeveralContacts, WhetherABoxSlidesOrTipsFromRest) {
  // It slides if mu < tan(beta) and mu < a/b; it tips about the lower corner if a/b < tan(beta) and a/b < mu.
  const MechanicalSystem system{Box<2>()};
  const auto mode = [&](double a, double b, double mu, double beta) {
    const MechanicalSystem::Start start = system.FindMode(
        std::vector{0.0, b, 0.0, 0.0, 0.0, 0.0}, {}, std::vector<double>{2, a, b, 9.81, 0, mu, beta, 0});
    EXPECT_GE(start.mode, 0) << start.reason;
    return start.mode < 0 ? "" : system.hybrid().ModeName(start.mode);
  };
  EXPECT_EQ(mode(0.3, 0.2, 0.3, 0.4), "++");
  EXPECT_EQ(mode(0.3, 0.2, 0.9, 0.4), "ss");
  EXPECT_EQ(mode(0.1, 0.3, 0.9, 0.4), "os");
}

// A point between a floor and a wall that are perpendicular: the impacts are independent. p = [restitution].
struct Corner {
  static constexpr int kNumCoordinates = 2, kNumControls = 0, kNumParameters = 1, kNumContacts = 2;
  template <typename T>
  void Mass(const T*, const T*, T* M) const {
    M[0] = M[3] = T(1.0);
    M[1] = M[2] = T(0.0);
  }
  template <typename T>
  void Force(const T&, const T*, const T*, const T*, const T*, T* h) const {
    h[0] = h[1] = T(0.0);
  }
  template <typename T>
  T Gap(int contact, const T* q, const T*) const {
    return q[contact];
  }
  template <typename T>
  T Restitution(int, const T* p) const {
    return p[0];
  }
};

TEST(SeveralContacts, IndependentImpactsAtOnceHaveADerivative) {
  const MechanicalSystem system{Corner()};
  HybridSimulator simulator(system.hybrid());
  ASSERT_TRUE(simulator.Rollout({.initial = {1, 1, -1, -1}, .parameters = {0.8}, .duration = 2}));
  EXPECT_EQ(simulator.ReasonNotDifferentiable(), "");
  EXPECT_EQ(simulator.events().size(), 2u);
  for (int i = 0; i < 4; ++i) EXPECT_NEAR(simulator.final_state()[i], 0.8, 1e-13);
  EXPECT_NEAR(simulator.Adjoint(std::vector<double>{1, 0, 0, 0}).initial[0], -0.8, 1e-13);
}

// Three balls of radius 0.1 and mass 1 on a line: [x0 x1 x2]. p = [restitution, force on the third].
struct Cradle {
  static constexpr int kNumCoordinates = 3, kNumControls = 0, kNumParameters = 2, kNumContacts = 2;
  static constexpr std::array<const char*, 2> kContactNames = {"a-b", "b-c"};
  template <typename T>
  void Mass(const T*, const T*, T* M) const {
    for (int i = 0; i < 9; ++i) M[i] = T(i % 4 == 0 ? 1.0 : 0.0);
  }
  template <typename T>
  void Force(const T&, const T*, const T*, const T*, const T* p, T* h) const {
    h[0] = h[1] = T(0.0);
    h[2] = p[1];
  }
  template <typename T>
  T Gap(int contact, const T* q, const T*) const {
    return q[contact + 1] - q[contact] - 0.2;
  }
  template <typename T>
  T Restitution(int, const T* p) const {
    return p[0];
  }
};

TEST(SeveralContacts, ThoseThatOnlyTouchAreNamedWhereAnotherHits) {
  const MechanicalSystem system{Cradle()};
  HybridSimulator simulator(system.hybrid());
  const auto remark = [&](double gap, double force) {
    const std::vector<double> x = {-0.5, 0, 0.2 + gap, 1, 0, 0}, p = {1, force};
    const MechanicalSystem::Start start = system.FindMode(x, {}, p);
    EXPECT_GE(start.mode, 0) << start.reason;
    EXPECT_TRUE(simulator.Rollout({.mode = start.mode, .initial = x, .parameters = p, .duration = 0.6}));
    return simulator.ReasonNotDifferentiable();
  };
  EXPECT_THAT(remark(0, 0), HasSubstr("'b-c' touch without a force where 'a-b' hits: the order of their impacts"));
  EXPECT_EQ(remark(1e-3, 0), "");
  EXPECT_NEAR(simulator.final_state()[5], 1, 1e-13) << "the third leaves with the speed of the first";
}

// ---------------------------------------------------------------------------------------------------------------------
// Painleve.

TEST(Painleve, SolutionsOfTheRod) {
  const MechanicalSystem system{SlidingRod()};
  for (const json& row : ClosedForms().at("P6_class")) {
    const double th = Number(row.at("theta")), om = Number(row.at("omega")), mu = Number(row.at("mu")), l = 0.5;
    const std::vector<double> p = {1, l, 9.81, 0, mu, 0, 0, 0};
    const std::vector<double> x = {
        l * std::cos(th), l * std::sin(th), th, -2 - l * std::sin(th) * om, l * std::cos(th) * om, om};
    const std::vector<ContactForces> solutions = system.ClosedContacts(x, {}, p);
    SCOPED_TRACE(row.dump());
    ASSERT_EQ(solutions.size(), row.at("solutions").size());
    std::string found;
    for (const ContactForces& solution : solutions) {
      found += solution.status;
      if (solution.status == "o") continue;
      EXPECT_NEAR(solution.normal[0], Number(row.at("lam")), 1e-11 * solution.normal[0]);
    }
    for (const json& solution : row.at("solutions")) {
      EXPECT_THAT(found, HasSubstr(solution.get<std::string>() == "open" ? "o" : "-"));
    }
    const MechanicalSystem::Start start = system.FindMode(x, {}, p);
    if (solutions.size() == 1) {
      EXPECT_EQ(system.hybrid().ModeName(start.mode), found);
    } else {
      EXPECT_EQ(start.mode, -1);
      EXPECT_THAT(start.reason, HasSubstr(solutions.empty() ? "painleve_inconsistent" : "painleve_indeterminate"));
      char expected[64];
      std::snprintf(expected, sizeof expected, "A = %.6g, b = %.6g", Number(row.at("A")), Number(row.at("b")));
      EXPECT_THAT(start.reason, HasSubstr(expected));
    }
  }
}

TEST(Painleve, AnglesAtWhichTheRodJams) {
  const MechanicalSystem system{SlidingRod()};
  const json& range = ClosedForms().at("P6_theta_range_mu1.5");
  for (int i = 0; i < 2; ++i) {
    const double th = Number(range[i]);
    const std::vector<double> p = {1, 0.5, 9.81, 0, 1.5, 0, 0, 0};
    const std::vector<double> x = {0, 0.5 * std::sin(th), th, -2, 0, 0};
    // The guards of mode '-' are off, stop and jam.
    EXPECT_NEAR(system.hybrid().functions().Guard({system.Mode("-"), 0, x.data(), nullptr, p.data()}, 2), 0, 1e-14);
  }
}

TEST(Painleve, AnImpactlessJamEndsTheMotionWithAReason) {
  const MechanicalSystem system{SlidingRod()};
  HybridSimulator simulator(system.hybrid());
  const double th = 0.8, om = 2, l = 0.5;
  const std::vector<double> p = {1, l, 9.81, 0, 1.5, 0, 0, 0};
  const std::vector<double> x = {
      l * std::cos(th), l * std::sin(th), th, -20 - l * std::sin(th) * om, l * std::cos(th) * om, om};
  ASSERT_FALSE(simulator.Rollout({.mode = system.Mode("-"), .initial = x, .parameters = p, .duration = 1}));
  EXPECT_THAT(simulator.FailureReason(), testing::AnyOf(HasSubstr("jammed"), HasSubstr("painleve")));
}

// ---------------------------------------------------------------------------------------------------------------------
// Accumulation, grazing, jumps of the control, starts.

TEST(Accumulation, OfTwoContactsInTurnEndsTheMotionWithAReason) {
  const MechanicalSystem system{CartPoleWithStops()};
  HybridSimulator simulator(system.hybrid());
  const HybridInput input{.initial = {0, 0.2, 0, 0},
                          .parameters = {1, 0.3, 0.6, 9.81, 0.1, 0.45, 0.15, 0.7, 0.5},
                          .duration = 1.5,
                          .num_intervals = 20,
                          .control = {4, 7, -3, -9, -6, 5, 10, 2, -8, -10, 3, 9, 6, -5, -7, 1, 8, -2, -4, 6}};
  ASSERT_FALSE(simulator.Rollout(input));
  EXPECT_THAT(simulator.FailureReason(), HasSubstr("Zeno behaviour"));
  ASSERT_FALSE(simulator.events().empty());
  EXPECT_NEAR(simulator.events().back().time, 1.1909, 1e-3);
}

TEST(Accumulation, ALimitOfEventsIsReported) {
  const MechanicalSystem system{BallOnIncline(), {.rest_speed = 0}};
  HybridSimulator simulator(system.hybrid(), {.most_events = 30});
  EXPECT_FALSE(simulator.Rollout({.initial = {0, 0.5, 2, 1}, .parameters = {1, 9.81, 0.3, 0.5, 0.2}, .duration = 2}));
  EXPECT_THAT(simulator.FailureReason(), HasSubstr("more than 30 events"));
}

TEST(MechanicalStart, PenetrationIsReported) {
  const MechanicalSystem system{BallOnIncline()};
  const MechanicalSystem::Start start =
      system.FindMode(std::vector{0.0, -1e-3, 0.0, 0.0}, {}, std::vector{1.0, 9.81, 0.3, 0.5, 0.2});
  EXPECT_EQ(start.mode, -1);
  EXPECT_THAT(start.reason, HasSubstr("contact 'ground' penetrates, its gap is -0.001"));
}

TEST(MechanicalStart, ABallThatGoesUpIsOpen) {
  const MechanicalSystem system{BallOnIncline()};
  const std::vector<double> p = {1, 9.81, 0.3, 0.5, 0.2};
  EXPECT_EQ(system.FindMode(std::vector{0.0, 0.0, 0.0, 1.0}, {}, p).mode, system.Mode("o"));
  EXPECT_EQ(system.FindMode(std::vector{0.0, 0.0, 3.0, 0.0}, {}, p).mode, system.Mode("+"));
  EXPECT_EQ(system.FindMode(std::vector{0.0, 0.0, 0.0, 0.0}, {}, p).mode, system.Mode("+"));
}

TEST(ControlJumps, ContactsOpenSlideAndStickAgain) {
  const MechanicalSystem system{PulledMass()};
  HybridSimulator simulator(system.hybrid());
  // It sticks, slides under 8 - 5 = 3, slows down under -5, sticks after 0.6 s, and is lifted.
  const HybridInput input{.mode = system.Mode("s"),
                          .initial = {0, 0, 0, 0},
                          .parameters = {0.5, 10},
                          .duration = 4,
                          .num_intervals = 4,
                          .control = {4, 0, 8, 0, 0, 0, 0, 12}};
  ASSERT_TRUE(simulator.Rollout(input)) << simulator.FailureReason();
  std::vector<std::string> modes;
  for (int k = 0; k <= 4; ++k) modes.push_back(system.hybrid().ModeName(simulator.ModeAt(k)));
  EXPECT_THAT(modes, ElementsAre("s", "+", "+", "o", "o"));
  ASSERT_EQ(simulator.events().size(), 1u);
  EXPECT_NEAR(simulator.events()[0].time, 2.6, 1e-13);
  EXPECT_NEAR(simulator.final_state()[0], 1.5 + 0.9, 1e-13);
  EXPECT_NEAR(simulator.final_state()[1], 1, 1e-13);
  // x = a^2 ... of the push u in the second interval: v = u - 5, x = v / 2 + v^2 / 10.
  EXPECT_NEAR(simulator.Adjoint(std::vector<double>{1, 0, 0, 0}).control[2], 0.5 + 3.0 / 5, 1e-12);
}

// The derivative of a function of [x p] by component i, by differences of fourth order.
template <typename Function>
std::vector<double> Difference(const Function& function, const std::vector<double>& at, std::size_t i) {
  const double h = 1e-3;
  const auto moved = [&](double step) {
    std::vector<double> y = at;
    y[i] += step;
    return function(y);
  };
  const std::vector<double> far_on = moved(2 * h), on = moved(h), back = moved(-h), far_back = moved(-2 * h);
  std::vector<double> out(on.size());
  for (std::size_t k = 0; k < out.size(); ++k) out[k] = (8 * (on[k] - back[k]) - (far_on[k] - far_back[k])) / (12 * h);
  return out;
}

// Solvers in phases meet states whose contacts are a little open or closed too far, and which move apart.
TEST(ClosedContacts, DerivativesHoldAtStatesThatAreNotOnTheEquationsOfTheContacts) {
  constexpr int kStates = 8, kColumns = kStates + 1 + LegHopper::kNumParameters;  // [x t p]
  const MechanicalSystem system{LegHopper()};
  const HybridFunctions& f = system.hybrid().functions();
  const std::vector<double> p = {2, 0.4, 0.3, 0.4, 0.45, 9.81, 0.4, 0.3, 0, 0.9, 0.7, -0.6}, u = {8, -0.2};
  std::vector<double> at = {-0.01, 0.72, 0.7, -0.6, 0.1, 0.3, -0.4, 0.2};  // the foot is 0.04 m above the ground
  at.insert(at.end(), p.begin(), p.end());
  const auto expect = [&](const auto& function, const std::vector<double>& jacobian, int columns) {
    for (std::size_t i = 0; i < at.size(); ++i) {
      const std::size_t column = i < kStates ? i : i + 1;
      const std::vector<double> by = Difference(function, at, i);
      for (std::size_t k = 0; k < by.size(); ++k) {
        EXPECT_NEAR(jacobian[k * columns + column], by[k], 1e-7 * std::max(1.0, std::abs(by[k]))) << k << " by " << i;
      }
    }
  };
  for (const std::string status : {"s", "+"}) {
    SCOPED_TRACE(status);
    const int mode = system.Mode(status);
    std::vector<double> after(kStates), jacobian(kStates * kColumns);
    const ModePoint point{mode, 0, at.data(), u.data(), &at[kStates]};
    f.ProjectJacobian(point, after.data(), jacobian.data());
    const auto project = [&](const std::vector<double>& y) {
      std::vector<double> out(kStates);
      f.Project(mode, y.data(), &y[kStates], out.data());
      return out;
    };
    EXPECT_EQ(project(at), after);
    expect(project, jacobian, kColumns);
    for (int guard = 0; guard < f.num_guards(mode); ++guard) {
      SCOPED_TRACE(f.GuardName(mode, guard));
      std::vector<double> gradient(kColumns + LegHopper::kNumControls);
      const double value = f.GuardGradient({mode, 0, at.data(), u.data(), &at[kStates]}, guard, gradient.data());
      const auto evaluate = [&](const std::vector<double>& y) {
        return std::vector{f.Guard({mode, 0, y.data(), u.data(), &y[kStates]}, guard)};
      };
      EXPECT_NEAR(evaluate(at)[0], value, 1e-12 * std::abs(value));
      expect(evaluate, gradient, static_cast<int>(gradient.size()));
      // Without the columns of the parameters the others stay the same.
      std::vector<double> others(gradient.size());
      f.GuardGradient({mode, 0, at.data(), u.data(), &at[kStates], /*by_parameters=*/false}, guard, others.data());
      for (std::size_t i = 0; i < gradient.size(); ++i) {
        if (i > kStates && i < kColumns) continue;
        EXPECT_NEAR(others[i], gradient[i], 1e-12 * std::abs(value)) << i;
      }
      const auto reset = [&](const std::vector<double>& y) {
        std::vector<double> out(kStates);
        f.Reset({mode, 0, y.data(), u.data(), &y[kStates]}, guard, out.data());
        return out;
      };
      if (f.ResetJacobian({mode, 0, at.data(), u.data(), &at[kStates]}, guard, after.data(), jacobian.data()) < 0) {
        continue;
      }
      expect(reset, jacobian, kColumns);
    }
  }
}

TEST(MechanicalModes, HaveALetterForEachContact) {
  const MechanicalSystem system{Box<4>()};
  EXPECT_EQ(system.hybrid().ModeName(0), "oooo");
  const int mode = system.Mode("s+oo");
  EXPECT_EQ(system.hybrid().ModeName(mode), "s+oo");
  EXPECT_EQ(system.Mode("s+oo"), mode);
  EXPECT_EQ(system.hybrid().GuardName(mode, 0), "off A");
  EXPECT_EQ(system.hybrid().GuardName(mode, 1), "break- A");
  EXPECT_EQ(system.hybrid().GuardName(mode, 4), "stop B");
  EXPECT_EQ(system.hybrid().GuardName(mode, 6), "hit C");
  EXPECT_DEATH(system.Mode("xooo"), "no contacts of this system have the status");
}

}  // namespace
}  // namespace saltus
