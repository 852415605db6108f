#include "contact/models/lcp_pgs.h"

#include <Eigen/Dense>
#include <array>

#include "base/linear_algebra.h"
#include "contact/formulation.h"

extern template class saltus::ContactStepOf<saltus::LcpPgs<false>, double>;
extern template class saltus::ContactStepOf<saltus::LcpPgs<true>, double>;

namespace saltus::testing {
namespace {

template <typename M>
class LcpPgsTest : public ::testing::Test {
 protected:
  const ContactStepOf<M, double> model_ = Compiled<M>(), without_correction_ = Compiled<M>({{"erp", 0}});
  // The options of the source's solver for articulated bodies.
  const ContactStepOf<M, double> one_sweep_ = Compiled<M>({{"sweeps", 1}, {"erp", 0.2}, {"cfm", 1e-5}});
};
using Variants = ::testing::Types<LcpPgs<false>, LcpPgs<true>>;
TYPED_TEST_SUITE(LcpPgsTest, Variants);

// Values of an independent implementation.
TYPED_TEST(LcpPgsTest, BounceOnce) {
  ExpectBounceOnce(this->model_, BounceOnce(), {1.301250, -25.3, -11.985625, -0.0249701});
  ExpectBounceOnce(this->without_correction_, BounceOnce(), {1.191667, 1, -0.095833, -0.0001997});
  ExpectBounceOnce(this->one_sweep_, BounceOnce(), {1.410809, -51.599474, -23.875168, -0.0497399});
}

TYPED_TEST(LcpPgsTest, GroundWall) {
  ExpectGroundWall(this->model_, GroundWall(0), {8.138289, -18.204906, -2.610558});
  ExpectGroundWall(this->without_correction_, GroundWall(0), {8.391678, 1.589760, -0.157195});
  ExpectGroundWall(this->model_, GroundWall(0.1), {11.485975, -9.805065, -8.829031});
  ExpectGroundWall(this->without_correction_, GroundWall(0.1), {11.544140, 3.055132, 0.254025});
}

TYPED_TEST(LcpPgsTest, TwoBalls) {
  ExpectTwoBalls(this->model_, TwoBalls(), {2.029814, -5.016897, 4.338938, -3.679058, 3.001099, -0.0064147});
  ExpectTwoBalls(this->without_correction_, TwoBalls(), {2.056731, 0, -0.716562, -0.220940, -0.495622, 0.0007897});
  ExpectTwoBalls(this->one_sweep_, TwoBalls(), {2.004392, -9.462518, 8.823155, -6.742044, 6.102681, -0.0127959});
}

// Every step from the first overlapping one, the 217th, moves the disc on by the corrected share of its depth.
TYPED_TEST(LcpPgsTest, CorrectionOfOverlapsDominatesTheGradient) {
  EXPECT_NEAR(LossDerivative(this->model_, BounceOnce(), "dp_y"), 1 - 0.1 * (480 - 217), 1e-9);
}

TYPED_TEST(LcpPgsTest, DerivativeIsThatOfDifferences) {
  for (const double friction : {0.2, 3.0}) {  // sliding; held
    Scene scene = ObliqueCollision(true);
    scene.contact.friction = friction;
    ExpectStepDerivative(this->model_, scene);
  }
  ExpectStepDerivative(this->model_, Corner(true));
}

TYPED_TEST(LcpPgsTest, JetsHaveScalarBits) {
  ExpectJetsHaveScalarBits(this->model_, ObliqueCollision(true));
  ExpectJetsHaveScalarBits(this->model_, Corner(true));
}

TYPED_TEST(LcpPgsTest, UnequalMassesKeepMomentum) { ExpectMomentumConserved(this->model_, ObliqueCollision(true)); }

TYPED_TEST(LcpPgsTest, FixedDiscActsAsHeavyOne) { ExpectFixedActsAsHeavy(this->model_, ObliqueCollision(true)); }

TYPED_TEST(LcpPgsTest, SlidingDiscStops) {
  const SlidingDisc slide = Slide(this->model_);
  EXPECT_NEAR(slide.speed_at_half, 1 - 0.1 * 9.8 * 0.5, 0.01);
  EXPECT_NEAR(slide.speed_at_end, 0, 1e-9);
}

// Three coupled normals with tangents: some rows free, some off, one sliding.
struct Coupled {
  Eigen::Matrix<double, 6, 6, Eigen::RowMajor> A;
  Eigen::VectorXd b = Eigen::VectorXd(6);
  double friction = 0.3;
  Coupled() {
    Eigen::MatrixXd root(6, 6);
    for (int i = 0; i < 6; ++i) {
      for (int j = 0; j < 6; ++j) root(i, j) = std::sin(1.7 * i + 2.3 * j * j + 0.4) + (i == j ? 1.5 : 0.0);
    }
    A = root.transpose() * root;
    b << 2.0, 1.5, -0.5, 0.2, 2.5, 0.1;
  }
  GaussSeidelSweeps Solve(int sweeps) const { return {{A.data(), 36}, {b.data(), 6}, {&friction, 1}, kKind, sweeps}; }
  static constexpr std::array<int, 3> kKind = {0, 0, 0};
};

// The reverse of the sweeps is the derivative of the sweeps, however few they are.
TEST(GaussSeidelSweepsTest, ReverseIsTheDerivative) {
  const Coupled problem;
  for (const int sweeps : {1, 2, 7, 200}) {
    for (int row = 0; row < 6; ++row) {
      const GaussSeidelSweeps::Derivative d = problem.Solve(sweeps).Reverse(row);
      const auto difference = [&](auto change) {
        Coupled up, down;
        change(up, 1e-6);
        change(down, -1e-6);
        return (up.Solve(sweeps).x()[row] - down.Solve(sweeps).x()[row]) / 2e-6;
      };
      const double mu = difference([](Coupled& p, double by) { p.friction += by; });
      EXPECT_NEAR(d.by_friction[0], mu, 1e-8 * (1 + std::abs(mu)));
      for (int i = 0; i < 6; ++i) {
        const double by_b = difference([&](Coupled& p, double by) { p.b[i] += by; });
        EXPECT_NEAR(d.by_b[i], by_b, 1e-8 * (1 + std::abs(by_b)));
        for (int j = 0; j < 6; ++j) {
          const double by_A = difference([&](Coupled& p, double by) { p.A(i, j) += by; });
          EXPECT_NEAR(d.by_A[6 * i + j], by_A, 1e-8 * (1 + std::abs(by_A)));
        }
      }
    }
  }
}

// In the limit it is that of the exact problem in the classes that the sweeps end in; the error falls geometrically.
TEST(GaussSeidelSweepsTest, DerivativeConvergesToTheExactOne) {
  const Coupled problem;
  const GaussSeidelSweeps limit = problem.Solve(20000);
  std::vector<int> rows;
  Eigen::MatrixXd follow = Eigen::MatrixXd::Identity(6, 6);  // x of all rows by x of the free ones
  for (int i = 0; i < 6; ++i) {
    const LcpClass kind = limit.ClassOf(i);
    if (kind == LcpClass::kClamping) rows.push_back(i);
    if (kind == LcpClass::kUpperBound) follow(i, i - 3) = problem.friction;
    if (kind == LcpClass::kLowerBound) follow(i, i - 3) = -problem.friction;
  }
  ASSERT_GE(rows.size(), 2u);
  const Eigen::MatrixXd Q = (problem.A * follow)(rows, rows);
  const Eigen::MatrixXd exact = PseudoInverse(Q);
  const auto error = [&](int sweeps) {
    double largest = 0;
    for (std::size_t i = 0; i < rows.size(); ++i) {
      const auto by_b = problem.Solve(sweeps).Reverse(rows[i]).by_b;
      for (std::size_t j = 0; j < rows.size(); ++j) {
        largest = std::max(largest, std::abs(by_b[rows[j]] - exact(i, j)));
      }
    }
    return largest;
  };
  EXPECT_GT(error(1), 1e-3);
  const double rate = error(10) / error(5);
  EXPECT_LT(rate, 0.5);
  EXPECT_GT(error(15) / error(10), rate / 3);
  EXPECT_LT(error(15) / error(10), rate * 3);
  EXPECT_LT(error(200), 1e-12);
}

}  // namespace
}  // namespace saltus::testing
