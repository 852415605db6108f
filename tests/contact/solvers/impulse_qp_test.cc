// Contact impulses of many discs against the conditions that define them.
#include "contact/solvers/impulse_qp.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>
#include <vector>

#include "parameter_name.h"

namespace saltus {
namespace {

struct Discs {
  std::vector<double> inverse_mass;
  std::vector<Vec2d> velocity;
  std::vector<ImpulseRow> rows;
};

// Discs on a triangular lattice above a floor, all contacts of which are in both directions of the cone of friction:
// far more rows than velocities.
Discs Lattice(int side, double friction, unsigned seed) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<double> uniform(-1, 1);
  Discs discs;
  std::vector<Vec2d> place;
  for (int j = 0; j < side; ++j) {
    for (int i = 0; i < side; ++i) {
      place.emplace_back(i + 0.5 * (j % 2), 0.5 + std::sqrt(0.75) * j);
      discs.inverse_mass.push_back(1 + 0.5 * uniform(random));
      discs.velocity.emplace_back(uniform(random), uniform(random) - 1);
    }
  }
  const auto add = [&](int a, int b, const Vec2d& normal) {
    const double apart = 0.05 * (1 + uniform(random));
    for (double sign : {-1.0, 1.0}) {
      discs.rows.push_back({a, b, normal + sign * friction * Perpendicular(normal), apart});
    }
  };
  for (int a = 0; a < side * side; ++a) {
    if (a < side) add(a, -1, {0, 1});
    for (int b = a + 1; b < side * side; ++b) {
      const Vec2d d = place[a] - place[b];
      if (d.norm() < 1.01) add(a, b, d.normalized());
    }
  }
  return discs;
}

class LatticesOf : public ::testing::TestWithParam<int> {};

TEST_P(LatticesOf, ObeyTheConditions) {
  for (unsigned seed = 0; seed < 20; ++seed) {
    for (double friction : {0.0, 0.2, 0.8}) {
      Discs discs = Lattice(GetParam(), friction, seed);
      const std::vector<Vec2d> given = discs.velocity;
      ASSERT_TRUE(SolveImpulseQp(discs.inverse_mass, discs.velocity, discs.rows)) << seed;
      std::vector<Vec2d> under = given;
      int active = 0;
      for (const ImpulseRow& row : discs.rows) {
        EXPECT_GE(row.impulse, 0);
        under[row.a] += discs.inverse_mass[row.a] * row.impulse * row.direction;
        if (row.b >= 0) under[row.b] -= discs.inverse_mass[row.b] * row.impulse * row.direction;
        Vec2d relative = discs.velocity[row.a];
        if (row.b >= 0) relative -= discs.velocity[row.b];
        const double left = Dot(row.direction, relative) + row.apart;
        EXPECT_GE(left, -1e-9);
        if (row.impulse > 1e-6) {
          EXPECT_NEAR(left, 0, 1e-7);
        }
        active += row.impulse > 1e-6;
      }
      for (std::size_t i = 0; i < under.size(); ++i) {
        EXPECT_NEAR((under[i] - discs.velocity[i]).norm(), 0, 1e-7) << i;
      }
      EXPECT_GT(active, GetParam());
    }
  }
}
INSTANTIATE_TEST_SUITE_P(ImpulseQp, LatticesOf, ::testing::Values(8, 24), ParameterName());

// A disc thrown against a wall: it slides on if that is faster than friction stops it.
TEST(ImpulseQp, ADiscOnAWall) {
  const double friction = 0.5;
  for (double along : {0.3, 2.0}) {
    std::vector<double> inverse_mass = {0.5};
    std::vector<Vec2d> velocity = {{along, -1}};
    std::vector<ImpulseRow> rows = {{0, -1, Vec2d(friction, 1), 0}, {0, -1, Vec2d(-friction, 1), 0}};
    ASSERT_TRUE(SolveImpulseQp(inverse_mass, velocity, rows));
    if (along < friction) {
      EXPECT_NEAR(velocity[0].norm(), 0, 1e-9);
      continue;
    }
    // f (-mu, 1) / m with -mu v_x + v_y = 0.
    const double f = (1 + friction * along) / (1 + friction * friction);
    EXPECT_NEAR(velocity[0][0], along - friction * f, 1e-9);
    EXPECT_NEAR(velocity[0][1], -1 + f, 1e-9);
    EXPECT_NEAR(rows[0].impulse, 0, 1e-9);
  }
}

TEST(ImpulseQp, AreNotFoundOfWhatIsNotFinite) {
  std::vector<double> inverse_mass = {1};
  std::vector<Vec2d> velocity = {{0, -INFINITY}};
  std::vector<ImpulseRow> rows = {{0, -1, Vec2d(0, 1), 0}};
  EXPECT_FALSE(SolveImpulseQp(inverse_mass, velocity, rows));
}

}  // namespace
}  // namespace saltus
