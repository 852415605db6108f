// Events at one time: which orders lead to other states or derivatives, and events that repeat without time passing.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <memory>
#include <numeric>
#include <random>
#include <string>
#include <vector>

#include "saltus/hybrid/hybrid_simulator.h"

namespace saltus {
namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;
using testing::HasSubstr;

// k guards that are zero together at t = 1 + shift, each with one event: the mode is the set of the guards that have
// had theirs. The state is [y z], y in R^4 and z in R^2. The velocity of y is constant in each mode, z' = a(mode) - z.
// Guard i is n_i (y - p_i e_i), and its reset is y+ = M_i y, z+ = Z_i z + C_i y + d_i, with p_i added to the first
// component of z.
struct TiedMotion {
  static constexpr int kY = 4, kZ = 2, kSize = kY + kZ;
  int num_guards = 2;
  std::vector<VectorXd> y_slope, a;  // of each mode
  std::vector<VectorXd> normal, d;   // of each guard
  std::vector<MatrixXd> M, Z, C;

  int num_modes() const { return 1 << num_guards; }
  VectorXd Slope(int mode, const VectorXd& x) const {
    VectorXd out(kSize);
    out << y_slope[mode], a[mode] - x.tail(kZ);
    return out;
  }
  double Guard(int guard, const VectorXd& x, const VectorXd& p) const {
    return normal[guard].dot(x.head(kY)) - p[guard] * normal[guard][guard];
  }
  MatrixXd ResetByState(int guard) const {
    MatrixXd out = MatrixXd::Zero(kSize, kSize);
    out.topLeftCorner(kY, kY) = M[guard];
    out.bottomLeftCorner(kZ, kY) = C[guard];
    out.bottomRightCorner(kZ, kZ) = Z[guard];
    return out;
  }
  VectorXd Reset(int guard, const VectorXd& x, const VectorXd& p) const {
    VectorXd out = ResetByState(guard) * x;
    out.tail(kZ) += d[guard];
    out[kY] += p[guard];
    return out;
  }

  // The motion in closed form: the state at `end`, and the guards in the order of their events; + 10 of one that a
  // reset has put below zero, whose transition belongs to the event before.
  VectorXd FinalState(VectorXd x, const VectorXd& p, double end, std::vector<int>* order) const {
    int mode = 0;
    double t = 0;
    order->clear();
    const auto fly = [&](double s) {
      x.head(kY) += y_slope[mode] * s;
      x.tail(kZ) = a[mode] + (x.tail(kZ) - a[mode]) * std::exp(-s);
      t += s;
    };
    for (;;) {
      int next = -1;
      double soonest = end - t;
      for (int guard = 0; guard < num_guards; ++guard) {
        if ((mode >> guard & 1) != 0) continue;
        const double s = std::max(Guard(guard, x, p), 0.0) / -normal[guard].dot(y_slope[mode]);
        if (s < soonest) {
          soonest = s;
          next = guard;
        }
      }
      fly(soonest);
      if (next < 0) return x;
      const bool behind = Guard(next, x, p) < -1e-12;
      x = Reset(next, x, p);
      mode |= 1 << next;
      order->push_back(next + (behind ? 10 : 0));
    }
  }
};

class TiedFunctions final : public HybridFunctions {
 public:
  explicit TiedFunctions(TiedMotion motion) : HybridFunctions(LayoutOf(motion)), motion_(std::move(motion)) {}

  void Flow(const ModePoint& at, double* xdot) const override { Out(xdot) = motion_.Slope(at.mode, State(at)); }
  void FlowJacobian(const ModePoint& at, double* xdot, double* jacobian) const override {
    Flow(at, xdot);
    const int columns = kSize + 1 + motion_.num_guards;
    std::fill_n(jacobian, kSize * columns, 0.0);
    for (int i = TiedMotion::kY; i < kSize; ++i) jacobian[i * columns + i] = -1;
  }
  double Guard(const ModePoint& at, int guard) const override {
    return Done(at, guard) ? 1 : motion_.Guard(guard, State(at), Parameters(at));
  }
  double GuardRate(const ModePoint& at, int guard, const double* xdot, double* rate) const override {
    *rate = Done(at, guard) ? 0 : motion_.normal[guard].dot(Eigen::Map<const VectorXd>(xdot, TiedMotion::kY));
    return Guard(at, guard);
  }
  double GuardGradient(const ModePoint& at, int guard, double* gradient) const override {
    std::fill_n(gradient, kSize + 1 + motion_.num_guards, 0.0);
    if (!Done(at, guard)) {
      std::copy_n(motion_.normal[guard].data(), TiedMotion::kY, gradient);
      gradient[kSize + 1 + guard] = -motion_.normal[guard][guard];
    }
    return Guard(at, guard);
  }
  int Reset(const ModePoint& at, int guard, double* x_plus) const override {
    Out(x_plus) = motion_.Reset(guard, State(at), Parameters(at));
    return at.mode | 1 << guard;
  }
  int ResetJacobian(const ModePoint& at, int guard, double* x_plus, double* jacobian) const override {
    Eigen::Map<Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>> by(
        jacobian, kSize, kSize + 1 + motion_.num_guards);
    by.setZero();
    by.leftCols(kSize) = motion_.ResetByState(guard);
    by(TiedMotion::kY, kSize + 1 + guard) = 1;
    return Reset(at, guard, x_plus);
  }

 private:
  static constexpr int kSize = TiedMotion::kSize;

  static HybridLayout LayoutOf(const TiedMotion& motion) {
    HybridLayout layout{.num_parameters = motion.num_guards};
    layout.state_sizes.assign(motion.num_modes(), kSize);
    layout.num_guards.assign(motion.num_modes(), motion.num_guards);
    return layout;
  }
  static bool Done(const ModePoint& at, int guard) { return (at.mode >> guard & 1) != 0; }
  static VectorXd State(const ModePoint& at) { return Eigen::Map<const VectorXd>(at.x, kSize); }
  VectorXd Parameters(const ModePoint& at) const { return Eigen::Map<const VectorXd>(at.p, motion_.num_guards); }
  static Eigen::Map<VectorXd> Out(double* numbers) { return {numbers, kSize}; }

  const TiedMotion motion_;
};

enum class Commute { kInStateAndDerivative, kInStateOnly, kNot };

TiedMotion RandomTies(std::mt19937* random, int num_guards, Commute commute) {
  std::normal_distribution<double> normal;
  constexpr int kY = TiedMotion::kY, kZ = TiedMotion::kZ;
  const auto matrix = [&](int rows, int columns, double size) {
    MatrixXd out(rows, columns);
    for (int i = 0; i < rows; ++i) {
      for (int j = 0; j < columns; ++j) out(i, j) = size * normal(*random);
    }
    return out;
  };
  TiedMotion motion;
  motion.num_guards = num_guards;
  for (int guard = 0; guard < num_guards; ++guard) {
    VectorXd n = 0.2 * matrix(kY, 1, 1);
    n[guard] = 1 + 0.5 * std::abs(normal(*random));
    motion.normal.push_back(n);
  }
  // Slopes along which all guards fall with rates of at least 0.3.
  const auto falling = [&](VectorXd slope) {
    for (int sweep = 0; sweep < 50; ++sweep) {
      for (const VectorXd& n : motion.normal) {
        const double rate = n.dot(slope);
        if (rate > -0.3) slope -= (rate + 0.5) / n.squaredNorm() * n;
      }
    }
    return slope;
  };
  const VectorXd first = falling(matrix(kY, 1, 1)), z_slope = matrix(kZ, 1, 1);
  std::vector<VectorXd> jump;
  for (int guard = 0; guard < num_guards; ++guard) jump.push_back(matrix(kZ, 1, 1));
  for (int mode = 0; mode < motion.num_modes(); ++mode) {
    const bool differs = commute != Commute::kInStateAndDerivative && mode > 0;
    motion.y_slope.push_back(differs ? falling(matrix(kY, 1, 1)) : first);
    VectorXd a = differs ? VectorXd(matrix(kZ, 1, 1)) : z_slope;
    for (int guard = 0; guard < num_guards; ++guard) {
      if (!differs && (mode >> guard & 1) != 0) a += jump[guard];
    }
    motion.a.push_back(a);
  }
  for (int guard = 0; guard < num_guards; ++guard) {
    const bool is_free = commute == Commute::kNot;
    motion.M.push_back(MatrixXd::Identity(kY, kY));
    if (commute != Commute::kInStateAndDerivative) motion.M.back() += matrix(kY, kY, 0.1);
    motion.Z.push_back(MatrixXd::Identity(kZ, kZ));
    if (is_free) motion.Z.back() += matrix(kZ, kZ, 0.4);
    motion.C.push_back(commute == Commute::kInStateAndDerivative ? MatrixXd::Zero(kZ, kY) : matrix(kZ, kY, 0.5));
    motion.d.push_back(matrix(kZ, 1, 1));
  }
  return motion;
}

// The product of the saltation matrices of the events in the order in which they happen, with the flows between: the
// derivative of the state at `end` by [x p], of a motion whose events are at t = 1 in this order.
MatrixXd SaltationProduct(const TiedMotion& motion, VectorXd x, const VectorXd& p, const std::vector<int>& order,
                          double end) {
  constexpr int kSize = TiedMotion::kSize, kY = TiedMotion::kY;
  const auto columns = static_cast<Eigen::Index>(kSize + p.size());
  MatrixXd by = MatrixXd::Zero(kSize, columns);
  by.leftCols(kSize).setIdentity();
  int mode = 0;
  const auto fly = [&](double s) {
    x.head(kY) += motion.y_slope[mode] * s;
    x.tail(TiedMotion::kZ) = motion.a[mode] + (x.tail(TiedMotion::kZ) - motion.a[mode]) * std::exp(-s);
    by.bottomRows(TiedMotion::kZ) *= std::exp(-s);
  };
  fly(1);
  for (const int guard : order) {
    Eigen::RowVectorXd of_guard = motion.normal[guard].transpose() * by.topRows(kY);
    of_guard[kSize + guard] -= motion.normal[guard][guard];
    const Eigen::RowVectorXd time = -of_guard / motion.normal[guard].dot(motion.y_slope[mode]);
    by += motion.Slope(mode, x) * time;
    by = MatrixXd(motion.ResetByState(guard) * by);
    by(kY, kSize + guard) += 1;
    x = motion.Reset(guard, x, p);
    mode |= 1 << guard;
    by -= motion.Slope(mode, x) * time;
  }
  fly(end - 1);
  return by;
}

TEST(TiedEvents, RandomTiesAreOneSidedWhereTheirOrdersDiffer) {
  constexpr double kWidth = 1e-6;
  constexpr int kSize = TiedMotion::kSize;
  std::mt19937 random(54);
  std::normal_distribution<double> normal;
  int smooth = 0, kinks = 0, jumps = 0;
  for (int trial = 0; trial < 270; ++trial) {
    const int num_guards = 2 + trial % 3;
    const auto commute = static_cast<Commute>(trial / 3 % 3);
    const double end = trial % 2 == 0 ? 1.7 : 2;  // the events are within a step of the integration, or at its end
    SCOPED_TRACE("tie " + std::to_string(trial) + " of " + std::to_string(num_guards) + " guards");
    const TiedMotion motion = RandomTies(&random, num_guards, commute);
    // From where all guards are at zero at t = 1.
    const VectorXd p = VectorXd::Zero(num_guards);
    VectorXd start(kSize);
    start.head(TiedMotion::kY) = -motion.y_slope[0];
    start.tail(TiedMotion::kZ) << normal(random), normal(random);

    HybridSimulator simulator{HybridSystem(std::make_shared<TiedFunctions>(motion))};
    const HybridInput input{.initial = {start.data(), start.data() + kSize},
                            .parameters = {p.data(), p.data() + num_guards},
                            .duration = end};
    ASSERT_TRUE(simulator.Rollout(input)) << simulator.FailureReason();
    ASSERT_EQ(simulator.events().size(), num_guards);
    ASSERT_EQ(simulator.ties().size(), 1u);
    EXPECT_EQ(simulator.ties()[0].guards.size(), num_guards);
    const std::string remark = simulator.ReasonNotDifferentiable();
    const HybridSensitivity found = simulator.Sensitivity();
    const Eigen::Map<const Eigen::Matrix<double, kSize, Eigen::Dynamic, Eigen::RowMajor>> derivative(
        found.final_state.data(), kSize, found.columns);
    const Eigen::Map<const VectorXd> final_state(simulator.final_state().data(), kSize);
    std::vector<int> taken, order;
    for (const HybridEvent& event : simulator.events()) taken.push_back(event.guard);
    const MatrixXd product = SaltationProduct(motion, start, p, taken, end);
    EXPECT_LT((derivative.leftCols(kSize + num_guards) - product).norm(), 1e-9 * product.norm());

    // One-sided differences in many directions: the derivative exists if all are those of one linear function.
    bool continuous = true, linear = true;
    for (int i = 0; i < 60; ++i) {
      VectorXd dx(kSize), dp(num_guards);
      for (double& number : dx) number = normal(random);
      for (double& number : dp) number = normal(random);
      const VectorXd moved = motion.FinalState(start + kWidth * dx, p + kWidth * dp, end, &order);
      const VectorXd change = (moved - final_state) / kWidth;
      const VectorXd expected = product.leftCols(kSize) * dx + product.rightCols(num_guards) * dp;
      const double difference = (change - expected).norm() / expected.norm();
      if (difference > 1e3) {
        continuous = false;
      } else if (difference > 1e-3) {
        linear = false;
      } else {
        EXPECT_LT(difference, 1e-4) << "between a kink and none";
      }
      if (order == taken) {
        EXPECT_LT(difference, 1e-4) << "in the order that was taken";
      }
    }
    if (!continuous) {
      ++jumps;
      EXPECT_TRUE(simulator.ties()[0].ambiguous);
      EXPECT_THAT(remark, HasSubstr("the order of their events matters"));
    } else {
      EXPECT_FALSE(simulator.ties()[0].ambiguous);
      ++(linear ? smooth : kinks);
      if (linear) {
        EXPECT_EQ(remark, "");
      } else {
        EXPECT_THAT(remark, HasSubstr("the derivatives depend on the order of their events"));
      }
    }
    EXPECT_EQ(continuous, commute != Commute::kNot);
    if (continuous) {
      EXPECT_EQ(linear, commute == Commute::kInStateAndDerivative);
    }
  }
  EXPECT_EQ(smooth, 90);
  EXPECT_EQ(kinks, 90);
  EXPECT_EQ(jumps, 90);
}

// A ball that moves to the right in the air, and on the ground with a quarter of that speed: [y v x]. p = [g e].
struct BallToRest {
  static constexpr int kNumControls = 0;
  static constexpr int kNumParameters = 2;
  static constexpr std::array kStateSizes = {3, 3};
  static constexpr std::array kNumGuards = {1, 0};

  template <typename T>
  void Flow(int mode, const T&, const T* x, const T*, const T* p, T* xdot) const {
    xdot[0] = mode == 0 ? x[1] : T(0.0);
    xdot[1] = mode == 0 ? T(-p[0]) : T(0.0);
    xdot[2] = T(mode == 0 ? 1.0 : 0.25);
  }
  template <typename T>
  T Guard(int, int, const T&, const T* x, const T*) const {
    return x[0];
  }
  template <typename T>
  int Reset(int, int, const T&, const T* x, const T* p, T* x_plus) const {
    x_plus[0] = x[0];
    x_plus[1] = -p[1] * x[1];
    x_plus[2] = x[2];
    return 0;
  }
  int OnAccumulation(int /*mode*/, int /*guard*/) const { return 1; }
};

TEST(EventsAtOnce, EndsInTheModeThatIsNamedAtEveryRestitution) {
  for (const double duration : {15.0, 1e4}) {
    for (const double e : {0.0, 1e-3, 0.05, 0.08, 0.1, 0.3, 0.5, 0.9}) {
      SCOPED_TRACE(std::to_string(e) + " over " + std::to_string(duration));
      HybridSimulator simulator{HybridSystem(BallToRest())};
      const HybridInput input{.initial = {1, 0, 0}, .parameters = {9.8, e}, .duration = duration};
      ASSERT_TRUE(simulator.Rollout(input)) << simulator.FailureReason();
      EXPECT_EQ(simulator.final_mode(), 1);
      ASSERT_TRUE(simulator.accumulation());
      // Falls for t1, and bounces for 2 t1 (e + e^2 + ...).
      const double t1 = std::sqrt(2 / 9.8), rest = t1 * (1 + e) / (1 - e), within = 1e-9 * duration / (1 - e);
      EXPECT_NEAR(*simulator.accumulation(), rest, 1e-10 * duration);
      EXPECT_NEAR(simulator.final_state()[2], rest + 0.25 * (duration - rest), within);
      EXPECT_NEAR(simulator.final_state()[0], 0, within * within);
      const HybridGradient by = simulator.Adjoint(std::vector<double>{0, 0, 1});
      EXPECT_NEAR(by.initial[0], 0.75 * rest / 2, within);
      EXPECT_NEAR(by.parameters[0], -0.75 * rest / (2 * 9.8), within);
      if (e == 0) {
        EXPECT_THAT(simulator.ReasonNotDifferentiable(), HasSubstr("the derivative is one-sided")) << "by e";
      } else {
        EXPECT_NEAR(by.parameters[1], 0.75 * 2 * t1 / ((1 - e) * (1 - e)), 40 * within / (1 - e));
        EXPECT_EQ(simulator.ReasonNotDifferentiable(), "");
      }
    }
  }
}

// A ball without restitution has all derivatives: [y v x], p = [g].
struct BallThatSticks {
  static constexpr int kNumControls = 0;
  static constexpr int kNumParameters = 1;
  static constexpr std::array kStateSizes = {3, 3};
  static constexpr std::array kNumGuards = {1, 0};

  template <typename T>
  void Flow(int mode, const T& t, const T* x, const T* u, const T* p, T* xdot) const {
    BallToRest().Flow(mode, t, x, u, p, xdot);
  }
  template <typename T>
  T Guard(int, int, const T&, const T* x, const T*) const {
    return x[0];
  }
  template <typename T>
  int Reset(int, int, const T&, const T* x, const T*, T* x_plus) const {
    x_plus[0] = x[0];
    x_plus[1] = T(0.0);
    x_plus[2] = x[2];
    return 0;
  }
  int OnAccumulation(int /*mode*/, int /*guard*/) const { return 1; }
};

TEST(EventsAtOnce, ABallThatSticksHasADerivative) {
  HybridSimulator simulator{HybridSystem(BallThatSticks())};
  ASSERT_TRUE(simulator.Rollout({.initial = {1, 0, 0}, .parameters = {9.8}, .duration = 3}));
  EXPECT_EQ(simulator.final_mode(), 1);
  EXPECT_EQ(simulator.events().size(), 1u);
  EXPECT_EQ(simulator.ReasonNotDifferentiable(), "");
  const double t1 = std::sqrt(2 / 9.8);
  EXPECT_NEAR(simulator.final_state()[2], 0.25 * 3 + 0.75 * t1, 1e-13);
  const HybridGradient by = simulator.Adjoint(std::vector<double>{0, 0, 1});
  EXPECT_NEAR(by.initial[0], 0.75 * t1 / 2, 1e-12);
  EXPECT_NEAR(by.initial[1], 0.75 / 9.8, 1e-12);
  EXPECT_NEAR(by.parameters[0], -0.75 * t1 / (2 * 9.8), 1e-12);
}

// n clocks that ring at once, each with a flag that a second transition takes back: [clock flag] of each.
class Clocks final : public HybridFunctions {
 public:
  explicit Clocks(int count)
      : HybridFunctions(
            {.num_controls = 0, .num_parameters = 0, .state_sizes = {2 * count}, .num_guards = {2 * count}}),
        count_(count) {}

  void Flow(const ModePoint&, double* xdot) const override {
    for (int i = 0; i < 2 * count_; ++i) xdot[i] = i % 2 == 0 ? -1 : 0;
  }
  void FlowJacobian(const ModePoint& at, double* xdot, double* jacobian) const override {
    Flow(at, xdot);
    std::fill_n(jacobian, 2 * count_ * (2 * count_ + 1), 0.0);
  }
  // The first half of the guards are the clocks, the others the flags.
  double Guard(const ModePoint& at, int guard) const override {
    return guard < count_ ? at.x[2 * guard] : 0.5 - at.x[2 * (guard - count_) + 1];
  }
  double GuardRate(const ModePoint& at, int guard, const double* xdot, double* rate) const override {
    *rate = guard < count_ ? xdot[2 * guard] : -xdot[2 * (guard - count_) + 1];
    return Guard(at, guard);
  }
  double GuardGradient(const ModePoint& at, int guard, double* gradient) const override {
    std::fill_n(gradient, 2 * count_ + 1, 0.0);
    gradient[guard < count_ ? 2 * guard : 2 * (guard - count_) + 1] = guard < count_ ? 1 : -1;
    return Guard(at, guard);
  }
  int Reset(const ModePoint& at, int guard, double* x_plus) const override {
    std::copy_n(at.x, 2 * count_, x_plus);
    const int i = guard < count_ ? guard : guard - count_;
    if (guard < count_) x_plus[2 * i] += 9;
    x_plus[2 * i + 1] = guard < count_ ? 1 : 0;
    return 0;
  }
  int ResetJacobian(const ModePoint& at, int guard, double* x_plus, double* jacobian) const override {
    const int columns = 2 * count_ + 1, of_flag = 2 * (guard < count_ ? guard : guard - count_) + 1;
    std::fill_n(jacobian, 2 * count_ * columns, 0.0);
    for (int i = 0; i < 2 * count_; ++i) jacobian[i * columns + i] = i == of_flag ? 0 : 1;
    return Reset(at, guard, x_plus);
  }

 private:
  const int count_;
};

TEST(EventsAtOnce, IndependentEventsAtOnceAreNone) {
  for (const int count : {2, 10, 51, 120}) {
    SCOPED_TRACE(count);
    HybridSimulator simulator{HybridSystem(std::make_shared<Clocks>(count))};
    HybridInput input{.initial = std::vector<double>(2 * count), .duration = 2};
    for (int i = 0; i < count; ++i) input.initial[2 * i] = 0.7;
    ASSERT_TRUE(simulator.Rollout(input)) << simulator.FailureReason();
    EXPECT_EQ(simulator.events().size(), 2u * count);
    ASSERT_EQ(simulator.ties().size(), 1u);
    EXPECT_FALSE(simulator.ties()[0].ambiguous);
    EXPECT_EQ(simulator.ReasonNotDifferentiable(), "");
    EXPECT_NEAR(simulator.final_state()[0], 9 - 1.3, 1e-13);
  }
}

TEST(EventsAtOnce, LimitsAreNamedWithTheGuardAndTheRemedy) {
  HybridInput input{.initial = {0.7, 0, 0.7, 0}, .duration = 2};
  HybridSimulator few(HybridSystem(std::make_shared<Clocks>(2)), {.most_events = 3});
  EXPECT_FALSE(few.Rollout(input));
  EXPECT_THAT(few.FailureReason(), HasSubstr("more than 3 events, in mode 'mode 0' at t = 0.7, of guard 'guard 3'"));
  EXPECT_THAT(few.FailureReason(), HasSubstr("raise most_events"));
}

}  // namespace
}  // namespace saltus
