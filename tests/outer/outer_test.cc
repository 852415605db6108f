// The layer for first programs, against closed forms and against the interfaces that it stands on.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <sstream>
#include <stdexcept>
#include <vector>

#include "folders.h"
#include "saltus/hybrid/mechanical_system.h"
#include "saltus/saltus.h"
#include "saltus/solve/hybrid_solver.h"

namespace saltus {
namespace {

using testing::HasSubstr;
using testing::ThrowsMessage;

struct Springs {
  static constexpr auto kName = "springs";
  double stiffness = 1e4;
  template <typename T>
  Vec2<T> Force(const Meeting<T>& m) const {
    return m.gap < 0 ? Vec2<T>(-stiffness * m.gap * m.normal) : m.Zero();
  }
};

struct Ball {
  static constexpr Sizes kSizes{.states = 2, .controls = 1, .parameters = 2, .guards = 1};
  static constexpr std::array kGuardNames = {"ground"};
  template <typename T>
  auto Flow(const At<T>& a) const {
    return Row<T>{a.x[1], a.u[0] - a.p[0]};
  }
  template <typename T>
  T Guard(const At<T>& a) const {
    return a.x[0];
  }
  template <typename T>
  auto Reset(const At<T>& a) const {
    return Row<T>{T(0), -a.p[1] * a.x[1]};
  }
};

// A thermostat: heated in mode 1, cooling in mode 0. Its rate doubles above a temperature of 20.
struct Thermostat {
  static constexpr Sizes kSizes{.states = 1, .parameters = 1, .guards = 1, .modes = 2, .switches = 1};
  template <typename T>
  auto Flow(const At<T>& a) const {
    const double rate = a.above[0] ? 2 : 1;
    return Row<T>{T(a.mode == 1 ? rate : -rate)};
  }
  template <typename T>
  T Switch(const At<T>& a) const {
    return a.x[0] - 20.0;
  }
  template <typename T>
  T Guard(const At<T>& a) const {
    return a.mode == 1 ? T(a.p[0] - a.x[0]) : T(a.x[0] - 18.0);
  }
  template <typename T>
  auto Reset(const At<T>& a) const {
    return ResetResult<T>{1 - a.mode, {a.x[0]}};
  }
};

struct GuardOfTheControl : Ball {
  template <typename T>
  T Guard(const At<T>& a) const {
    return a.u[0];
  }
};

struct DoubleIntegrator {
  static constexpr Sizes kSizes{.states = 2, .controls = 1};
  template <typename T>
  auto Flow(const At<T>& a) const {
    return Row<T>{a.x[1], a.u[0]};
  }
};

std::string Printed(const auto& result) {
  std::ostringstream out;
  out << result;
  return out.str();
}

TEST(OuterTest, ASystemBouncesAsItsClosedForm) {
  HybridSimulator simulator(MakeHybridSystem(Ball()));
  ASSERT_TRUE(simulator.Rollout({.initial = {1.25, 0}, .parameters = {10, 0.5}, .duration = 0.7}));
  // It falls for 0.5 s, and rises with 2.5 m/s for 0.2 s.
  EXPECT_NEAR(simulator.final_state()[0], 2.5 * 0.2 - 5 * 0.04, 1e-13);
  EXPECT_NEAR(simulator.final_state()[1], 0.5, 1e-13);
  // dy/de = 5 * 0.2.
  EXPECT_NEAR(simulator.Adjoint(std::vector<double>{1, 0}).parameters[1], 1.0, 1e-12);
}

TEST(OuterTest, ModesAndSwitchesBehaveAsStated) {
  HybridSimulator simulator(MakeHybridSystem(Thermostat()));
  // From 18 to 20 in 2, to 24 in 2 more; down to 20 in 2, to 18 in 2; up to 19.5 in 1.5.
  ASSERT_TRUE(simulator.Rollout({.mode = 1, .initial = {18}, .parameters = {24}, .duration = 9.5}))
      << simulator.FailureReason();
  EXPECT_NEAR(simulator.final_state()[0], 19.5, 1e-12);
  // A threshold that is higher by d is met later by d / 2, and left by d / 2 later: the end is lower by d.
  EXPECT_NEAR(simulator.Adjoint(std::vector<double>{1}).parameters[0], -1.0, 1e-12);
}

TEST(OuterTest, RestitutionThatReachesAHeightIsFound) {
  Problem problem(Ball(), {.initial = {1.25, 0}, .parameters = {10, 0.5}, .duration = 0.7});
  problem.AddCost(kEnd, [](const auto& a) { return a.x[0] - 0.6; }).Free({.parameters = {{"p[1]", 0.1, 1.0}}});
  const auto run = Solve(problem);
  EXPECT_TRUE(run.converged()) << run;
  EXPECT_NEAR(run["p[1]"], 0.8, 1e-9);  // 5 e 0.2 - 0.2 = 0.6
  EXPECT_THAT([&] { run["p[0]"]; },
              ThrowsMessage<std::invalid_argument>(HasSubstr("expected something that was free: p[1]")));
  EXPECT_THAT(Printed(run), HasSubstr("p[1] = 0.8"));
  EXPECT_THAT(Printed(run), HasSubstr("converged"));
  EXPECT_THAT(Printed(run.certificate()), HasSubstr("certificate: "));
}

TEST(OuterTest, InequalitiesHoldBetweenNodesToo) {
  // Thrown up from its limit the ball is above it at once, whatever the intervals.
  const auto solve = [](double highest, int intervals) {
    Problem problem(Ball(),
                    {.initial = {50, 4}, .parameters = {9.8, 0.98}, .duration = 15, .num_intervals = intervals});
    problem.AddCost(kEnd, [](const auto& a) { return a.x[0] - 20.0; });
    problem.AddInequality(kAlways, [highest](const auto& a) { return a.x[0] - highest; });
    problem.Free({.initial = {{"x[1]", -20, 20}}, .parameters = {{"p[1]", 0.75, 1.0}}});
    return Solve(problem);
  };
  const auto free = solve(60, 1);
  ASSERT_TRUE(free.converged()) << free;
  EXPECT_LT(free.loss(), 1e-12);
  for (const int intervals : {1, 300}) {
    const auto low = solve(50, intervals);
    ASSERT_TRUE(low.converged()) << low;
    EXPECT_LT(low["x[1]"], 1e-3);  // it rises by v^2 / 2 g
    EXPECT_LT(low.loss(), 1e-12);
  }
}

// Returns the largest position of a unit mass under piecewise constant forces, from 0 with the speed 1.
double Top(const Run& run) {
  double x = 0, v = 1, top = 0;
  const std::vector<double>& control = run.report().solution.control;
  for (size_t k = 0; k < control.size(); ++k) {
    const double h = run.report().solution.durations.empty() ? 1.0 / static_cast<double>(control.size())
                                                             : run.report().solution.durations[k];
    const double u = control[k], turn = -v / u;
    if (turn > 0 && turn < h) top = std::max(top, x - v * v / (2 * u));
    x += v * h + u * h * h / 2;
    v += u * h;
    top = std::max(top, x);
  }
  return top;
}

// Bryson and Denham: from v = 1 back to v = -1 with x at most 1/9, of least effort.
Run SolveBrysonDenham(auto system, int intervals, int mode = 0) {
  Problem problem(std::move(system), {.mode = mode, .initial = {0, 1}, .duration = 1, .num_intervals = intervals});
  problem.AddEffort(0.5)
      .AddEquality(kEnd,
                   [](const auto& a) {
                     return Row{a.x[0], a.x[1] + 1.0};
                   })
      .AddInequality(kAlways, [](const auto& a) { return a.x[0] - 1.0 / 9; })
      .Free({.control = true});
  return Solve(problem);
}

// A unit mass on a rail that ends far away.
struct Rail {
  static constexpr int kNumCoordinates = 1, kNumControls = 1, kNumParameters = 0, kNumContacts = 1;
  template <typename T>
  void Mass(const T*, const T*, T* mass) const {
    mass[0] = T(1);
  }
  template <typename T>
  void Force(const T&, const T*, const T*, const T* u, const T*, T* force) const {
    force[0] = u[0];
  }
  template <typename T>
  T Gap(int, const T* q, const T*) const {
    return q[0] + 10.0;
  }
  template <typename T>
  T Restitution(int, const T*) const {
    return T(0);
  }
};

TEST(OuterTest, BrysonAndDenhamStayBelowTheLimitAtAllTimes) {
  // On three intervals both conditions at the end leave the forces (a, -6 - 2 a, a). The first top is 1 / (-2 a), at
  // -1 / a < 1/3, so that a = -9/2 and the loss is (2 a^2 + 9) / 6; at the nodes alone a = -4 and the loss 6 are
  // enough.
  const MechanicalSystem rail{Rail()};
  for (const auto& run :
       {SolveBrysonDenham(DoubleIntegrator(), 3), SolveBrysonDenham(rail.hybrid(), 3, rail.Mode("o"))}) {
    ASSERT_TRUE(run.converged()) << run;
    EXPECT_NEAR(run.loss(), 8.25, 1e-7);
    EXPECT_NEAR(run.report().solution.control[1], 3, 1e-7);
    EXPECT_NEAR(Top(run), 1.0 / 9, 1e-9);
    EXPECT_TRUE(run.certificate().IsStationary()) << run.certificate();
  }
  // No force has a loss below 4.
  for (const int intervals : {7, 20, 31}) {
    const auto run = SolveBrysonDenham(DoubleIntegrator(), intervals);
    ASSERT_TRUE(run.converged()) << run;
    EXPECT_GT(run.loss(), 4);
    EXPECT_LT(run.loss(), 4 + 16.0 / (intervals * intervals));
    EXPECT_LT(Top(run), 1.0 / 9 + 1e-8);
    // The optimum in continuous time is at the limit from t = 1/3 to 2/3.
    EXPECT_THAT(run.certificate().reason, HasSubstr("holds always, and is at its bound in control intervals from t = "))
        << intervals;
  }
}

// A unit mass on a rough floor, under a gravity of 10.
struct Block {
  static constexpr int kNumCoordinates = 2, kNumControls = 1, kNumParameters = 1, kNumContacts = 1;
  template <typename T>
  void Mass(const T*, const T*, T* mass) const {
    mass[0] = mass[3] = T(1);
    mass[1] = mass[2] = T(0);
  }
  template <typename T>
  void Force(const T&, const T*, const T*, const T* u, const T*, T* force) const {
    force[0] = u[0];
    force[1] = T(-10);
  }
  template <typename T>
  T Gap(int, const T* q, const T*) const {
    return q[1];
  }
  template <typename T>
  T Slide(int, const T* q, const T*) const {
    return q[0];
  }
  template <typename T>
  T Friction(int, const T* p) const {
    return p[0];
  }
  template <typename T>
  T Restitution(int, const T*) const {
    return T(0);
  }
};

TEST(OuterTest, AProblemOfAMechanicalSystemStartsInTheModeOfItsState) {
  const MechanicalSystem block{Block()};
  const HybridInput rests{.initial = {0, 0, 0, 0}, .parameters = {0.2}, .duration = 2, .control = {3}};
  Problem problem(block, rests);
  EXPECT_EQ(problem.parts().guess.mode, block.Mode("+"));  // pushed by more than its friction
  problem.AddCost(kEnd, [](const auto& a) { return a.x[0] - 1.0; }).Free({.parameters = {{"p[0]", 0, 0.29}}});
  const auto run = Solve(problem);
  EXPECT_NEAR(run["p[0]"], 0.25, 1e-9) << run;  // (3 - 10 p) 2^2 / 2 = 1
  HybridInput sticks = rests;
  sticks.mode = block.Mode("s");  // a mode that is named is taken
  EXPECT_EQ(Problem(block, sticks).parts().guess.mode, sticks.mode);
  HybridInput below = rests;
  below.initial[1] = -1;
  EXPECT_THROW(Problem(block, below), std::invalid_argument);
  EXPECT_THROW(Problem(block, {.initial = {0}, .parameters = {0.2}, .duration = 2}), std::invalid_argument);
}

TEST(OuterTest, InequalitiesOfTimeAndControlHoldToTheEndsOfIntervals) {
  // To the speed 1 within 1 of least effort, under u <= 2.2 - 1.5 t: the second force is 0.7, the first 1.3.
  Problem problem(DoubleIntegrator(), {.initial = {0, 0}, .duration = 1, .num_intervals = 2});
  problem.AddEffort(1)
      .AddEquality(kEnd, [](const auto& a) { return a.x[1] - 1.0; })
      .AddInequality(kAlways, [](const auto& a) { return a.u[0] + 1.5 * a.t - 2.2; })
      .Free({.control = true});
  const auto run = Solve(problem);
  ASSERT_TRUE(run.converged()) << run;
  EXPECT_NEAR(run.loss(), (1.3 * 1.3 + 0.7 * 0.7) / 2, 1e-8);
  EXPECT_TRUE(run.certificate().IsStationary()) << run.certificate();
}

TEST(OuterTest, InequalitiesOfTheControlAloneHoldInEveryInterval) {
  Problem problem(DoubleIntegrator(), {.initial = {0, 0}, .duration = 1, .num_intervals = 4});
  problem.AddValue(kEnd, [](const auto& a) { return -a.x[0]; })
      .AddInequality(kAlways,
                     [](const auto& a) {
                       return Row{a.u[0] - 2.0, -a.u[0] - 2.0};
                     })
      .Free({.control = true});
  const auto run = Solve(problem);
  ASSERT_TRUE(run.converged()) << run;
  EXPECT_NEAR(run.loss(), -1, 1e-8);
  EXPECT_TRUE(run.certificate().IsStationary()) << run.certificate();
}

TEST(OuterTest, InequalitiesHoldBehindAnEvent) {
  // Thrown down as fast as may be, the ball does not rise above 1 behind its bounce with v: 0.64 v^2 = 2 g.
  Problem problem(Ball(), {.initial = {0.5, -1}, .parameters = {9.81, 0.8}, .duration = 0.65});
  problem.AddValue(BeforeEvent("ground"), [](const auto& a) { return a.x[1]; })
      .AddInequality(kAlways, [](const auto& a) { return a.x[0] - 1.0; })
      .Free({.initial = {{"x[1]", -10, 0}}});
  const auto run = Solve(problem);
  ASSERT_TRUE(run.converged()) << run;
  EXPECT_NEAR(run.loss(), -std::sqrt(2 * 9.81 / 0.64), 1e-8);
}

TEST(OuterTest, CostsOfAllIntervalsAreIntegrals) {
  const HybridInput guess = {.initial = {0, 0}, .duration = 2, .num_intervals = 4, .control = {1, 2, -1, 3}};
  const auto loss = [&](const auto& add) {
    Problem problem(DoubleIntegrator(), guess);
    add(&problem);
    problem.Free({.control = true});
    return Solve("gd", problem.parts(), {.limits = {.iterations = 0}}).guess.loss;
  };
  const auto control = [](const auto& a) { return a.u[0]; };
  EXPECT_NEAR(loss([&](Problem* p) { p->AddCost(kAlways, control); }), 0.5 * (1 + 4 + 1 + 9), 1e-14);
  EXPECT_NEAR(loss([&](Problem* p) { p->AddEffort(1); }), 0.5 * (1 + 4 + 1 + 9), 1e-14);
  EXPECT_NEAR(loss([&](Problem* p) { p->AddValue(kAlways, control); }), 0.5 * (1 + 2 - 1 + 3), 1e-14);
  EXPECT_NEAR(loss([&](Problem* p) { p->AddValue(kEnd, [](const auto& a) { return a.x[1]; }); }), 2.5, 1e-13);
  EXPECT_NEAR(loss([&](Problem* p) { p->AddDuration(3); }), 6, 1e-14);
  EXPECT_NEAR(
      loss([&](Problem* p) { p->AddCost(kEnd, [](const auto& a) {
                               return Row{a.t, a.x[1]};
                             }); }), 4 + 6.25, 1e-12);
}

TEST(OuterTest, EqualitiesAndInequalitiesHold) {
  // Least effort from rest to rest over a distance of 1 in 1, with the speed below 1.2 at nodes.
  Problem problem(DoubleIntegrator(), {.initial = {0, 0}, .duration = 1, .num_intervals = 20});
  problem.AddEffort(1)
      .AddEquality(kEnd,
                   [](const auto& a) {
                     return Row{a.x[0] - 1.0, a.x[1]};
                   })
      .AddInequality(kAlways, [](const auto& a) { return a.x[1] - 1.2; })
      .Free({.controls = {{"u[0]", -20, 20}}});
  const auto run = Solve(problem);
  ASSERT_TRUE(run.converged()) << run;
  // Continuous: v = 1.2 (1 - (1 - t / s)^2) up to s, then 1.2; 1 = 1.2 (1 - 2 s / 3), the effort is 2 * 4/3 * 1.44 / s.
  const double s = 0.25;
  EXPECT_NEAR(run.loss(), 8.0 / 3 * 1.44 / s, 0.05 * run.loss());
  HybridSimulator simulator(problem.parts().system);
  ASSERT_TRUE(simulator.Rollout(SolutionOf(problem.parts(), run.report())));
  EXPECT_NEAR(simulator.final_state()[0], 1, 1e-8);
  for (int k = 0; k <= 20; ++k) EXPECT_LT(simulator.StateAt(k)[1], 1.2 + 1e-7);
}

TEST(OuterTest, TermsAtEventsCountEachEvent) {
  const HybridInput guess = {.initial = {1.25, 0}, .parameters = {10, 0.5}, .duration = 0.7};
  Problem problem(Ball(), guess);
  problem.AddValue(BeforeEvent("ground"), [](const auto& a) { return a.x[1]; });
  problem.AddValue(OnEvent("ground"), [](const auto& a) { return 10.0 * a.x[1]; });
  problem.Free({.initial = {{"x[0]"}}});
  EXPECT_NEAR(Solve("gd", problem.parts(), {.limits = {.iterations = 0}}).guess.loss, -5 + 25, 1e-12);
  EXPECT_THAT([&] { problem.AddValue(OnEvent("wall"), [](const auto& a) { return a.x[1]; }); },
              ThrowsMessage<std::invalid_argument>("Problem: term 2: found the event 'wall', expected some of ground"));
}

TEST(OuterTest, WrongProblemsAreRefusedWithTheirNames) {
  const HybridInput guess = {.initial = {1.25, 0}, .parameters = {10, 0.5}, .duration = 0.7};
  EXPECT_THAT(
      [&] {
        Problem(Ball(), {.initial = {1}, .parameters = {10, 0.5}, .duration = 1});
      },
      ThrowsMessage<std::invalid_argument>(HasSubstr("expected")));
  Problem problem(Ball(), guess);
  EXPECT_THAT([&] { problem.AddCost(kEnd, [](const auto& a) { return a.u[0]; }); },
              ThrowsMessage<std::out_of_range>("term 0: found u[0], expected none, as it has no u"));
  EXPECT_THAT([&] { problem.AddCost(kAlways, [](const auto& a) { return a.x[2]; }); },
              ThrowsMessage<std::out_of_range>("term 0: found x[2], expected x[0] to x[1]"));
  EXPECT_THAT(([&] {
                Problem(GuardOfTheControl(), {.initial = {1, 0}, .parameters = {10, 0.5}, .duration = 1});
              }),
              ThrowsMessage<std::out_of_range>("Guard: found u[0], expected none, as it has no u"));
  EXPECT_THAT([&] { problem.AddCost(kEnd, [](const auto&) { return std::vector<double>(); }); },
              ThrowsMessage<std::length_error>(HasSubstr("returns no numbers")));
  EXPECT_THAT([&] { Solve(problem); }, ThrowsMessage<std::invalid_argument>(HasSubstr("without terms")));
  EXPECT_THAT([&] { problem.Free({.parameters = {{"e"}}}); },
              ThrowsMessage<std::invalid_argument>("parameters: found 'e', expected some of p[0], p[1]"));
  EXPECT_THAT(
      [&] {
        problem.Free({.parameters = {{"p[1]", 1, 0}}});
      },
      ThrowsMessage<std::invalid_argument>(HasSubstr("above the upper one")));
  EXPECT_THAT(([&] {
                problem.Free({.parameters = {{"p[1]", std::nan(""), 1}}});
              }),
              ThrowsMessage<std::invalid_argument>(HasSubstr("found NaN as a bound of the parameters")));
  EXPECT_THAT(([&] {
                problem.Free({.controls = {{"u[0]", 0, std::nan("")}}});
              }),
              ThrowsMessage<std::invalid_argument>(HasSubstr("found NaN as a bound of the control")));
  for (const BoundedVariable& wrong :
       {BoundedVariable{"", -1, 1}, BoundedVariable{"", -2, -1}, BoundedVariable{.name = "", .max = 0}}) {
    EXPECT_THAT([&] { problem.Free({.duration = wrong}); },
                ThrowsMessage<std::invalid_argument>(HasSubstr("as the duration is positive")));
  }
  EXPECT_THAT(([&] {
                problem.Free({.duration = BoundedVariable{"", std::nan(""), 1}});
              }),
              ThrowsMessage<std::invalid_argument>(HasSubstr("found NaN as a bound of the duration")));
  EXPECT_NO_THROW(problem.Free({.duration = BoundedVariable{.name = "", .max = 1}}));
  problem.AddCost(kEnd, [](const auto& a) { return a.x[0]; }).Free({.parameters = {{"p[1]"}}});
  EXPECT_THAT([&] { Solve(problem, {.solver = "simplex"}); },
              ThrowsMessage<std::invalid_argument>(HasSubstr("simplex")));
}

TEST(OuterTest, ATermOfAnotherSizeThanForTheGuessIsRefused) {
  Problem problem(Ball(), {.initial = {1.25, 0}, .parameters = {10, 0.5}, .duration = 0.4});
  problem.AddCost(kEnd, [](const auto& a) {
    std::vector numbers = {a.x[0]};
    if (a.x[1] < 0) numbers.resize(100, a.x[1]);  // as at the end, but not at the start
    return numbers;
  });
  problem.Free({.initial = {{"x[0]"}}});
  EXPECT_THAT([&] { Solve("gd", problem.parts(), {.limits = {.iterations = 1}}); },
              ThrowsMessage<std::length_error>("term 0: found 100 numbers, expected 1 as for the guess"));
}

TEST(OuterTest, ARunThatFailsPrintsItsReasonOnce) {
  // The ball falls without end, and may have two events.
  Problem problem(Ball(), {.initial = {1.25, 0}, .parameters = {10, 0.5}, .duration = 3});
  problem.parts().integration.most_events = 2;
  problem.AddCost(kEnd, [](const auto& a) { return a.x[0]; }).Free({.initial = {{"x[0]"}}});
  const auto run = Solve(problem);
  ASSERT_FALSE(run.converged());
  EXPECT_THAT(Printed(run), testing::ContainsRegex("more than 2[ \n]+events"));
  EXPECT_EQ(Printed(run.certificate()), "certificate: none\n  there is no solution to certify\n");
}

TEST(OuterTest, AForceIsTheSpringOfTheLibrary) {
  Scene scene = Load(SourceFolder() + "/problems/two_balls.yaml");
  scene.contact.damping = scene.contact.friction = 0;
  for (const double stiffness : {1e3, 1e4}) {
    scene.contact.stiffness = stiffness;
    const auto gradient = [&](const Contact& contact) {
      return AuditModel(contact, scene, Precision::kDouble, std::nullopt, {.attribution = false}).gradient;
    };
    const ModelGradient own = gradient(ForceContact(Springs{.stiffness = stiffness})),
                        spring = gradient("compliant_warp");
    ASSERT_TRUE(own.ok() && spring.ok()) << own.reason << spring.reason;
    EXPECT_NEAR(own.loss, spring.loss, 1e-9);
    for (std::size_t i = 0; i < spring.gradient.initial.size(); ++i) {
      EXPECT_NEAR(own.gradient.initial[i], spring.gradient.initial[i], 1e-6) << i;
    }
  }
}

TEST(OuterTest, AnAuditPrintsItsTables) {
  const Scene scene = Load(SourceFolder() + "/problems/two_balls.yaml");
  const GradientAudit audit = AuditGradient(Springs(), scene);
  EXPECT_EQ(audit.model().verdict, Verdict::kWrongSign);
  EXPECT_THAT(Printed(audit), HasSubstr("gradient of the loss at the initial guess"));
  EXPECT_THAT(Printed(audit), HasSubstr("wrong sign"));
  Scene rough = scene;
  rough.contact.friction = 0.3;
  EXPECT_THAT([&] { AuditGradient(Springs(), rough); },
              ThrowsMessage<std::invalid_argument>("AuditGradient: springs: this model knows no friction"));
  EXPECT_THAT([&] { Load("no_such_scene.yaml"); },
              ThrowsMessage<std::invalid_argument>(HasSubstr("no_such_scene.yaml")));
}

TEST(OuterTest, ASceneIsSolvedAndCertified) {
  const auto run = Solve(Load(SourceFolder() + "/problems/two_balls.yaml"));
  EXPECT_TRUE(run.converged()) << run;
  EXPECT_NEAR(run.loss(), 1.3965421601, 1e-6);  // the optimum in continuous time
  EXPECT_THAT(Printed(run.certificate()), HasSubstr("minimum"));
}

}  // namespace
}  // namespace saltus
