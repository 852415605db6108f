// First closings against polynomials built from known zeros, and against dense sampling.
#include "contact/event/event_roots.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>
#include <vector>

namespace saltus {
namespace {

// lead * prod (s - zero)
GapPolynomial WithZeros(const std::vector<double>& zeros, double lead) {
  GapPolynomial g;
  g.c[0] = lead;
  int degree = 0;
  for (double zero : zeros) {
    ++degree;
    for (int k = degree; k >= 0; --k) g.c[k] = (k > 0 ? g.c[k - 1] : 0.0) - zero * g.c[k];
  }
  g.degree = std::max(4, degree);
  return g;
}

double Noise(const GapPolynomial& g, double s) {
  double sum = 0;
  for (int k = g.degree; k >= 0; --k) sum = sum * std::abs(s) + std::abs(g.c[k]);
  return 1e-15 * sum;
}

TEST(FirstClosing, SimpleZerosOfQuartics) {
  EXPECT_NEAR(FirstClosing(WithZeros({1, 2, 3, 4}, 1), 10), 1, 1e-14);
  EXPECT_NEAR(FirstClosing(WithZeros({-1, 2, 3, 4}, 1), 10), 3, 1e-14);
  EXPECT_NEAR(FirstClosing(WithZeros({-1, 0.5, 3, 7}, -1), 10), 0.5, 1e-14);
  EXPECT_EQ(FirstClosing(WithZeros({1, 2, 3, 4}, 1), 0.999), kNever);
  EXPECT_EQ(FirstClosing(WithZeros({-4, -3, -2, -1}, 1), 10), kNever);
}

TEST(FirstClosing, SimpleZerosOfHigherDegree) {
  EXPECT_NEAR(FirstClosing(WithZeros({-2, 0.5, 1, 3, 5}, 1), 10), 0.5, 1e-13);
  EXPECT_NEAR(FirstClosing(WithZeros({-0.3, -0.2, 0.1, 0.3, 0.5, 0.7, 0.9, 1.1, 1.3, 1.5}, 1), 1), 0.1, 1e-13);
  EXPECT_NEAR(FirstClosing(WithZeros({-0.3, -0.2, 0.1, 0.3, 0.5, 0.7, 0.9, 1.1, 1.3, 1.5}, -1), 1), 0.3, 1e-12);
}

TEST(FirstClosing, NearlyDoubleZeros) {
  for (double apart : {1e-1, 1e-3, 1e-5, 1e-7}) {
    EXPECT_NEAR(FirstClosing(WithZeros({0.5, 0.5 + apart, 3, 4}, 1), 1), 0.5, 1e-14 / apart);
    EXPECT_NEAR(FirstClosing(WithZeros({0.5, 0.5 + apart}, 1), 1), 0.5, 1e-14 / apart);
  }
}

TEST(FirstClosing, StartsOnAZero) {
  EXPECT_EQ(FirstClosing(WithZeros({0, 1, 2, 3}, 1), 10), 0) << "falling";
  EXPECT_NEAR(FirstClosing(WithZeros({0, 1, 2, 3}, -1), 10), 1, 1e-14) << "rising";
  EXPECT_NEAR(FirstClosing(WithZeros({0, 1, 2, 3}, 1), 10, true), 2, 1e-14) << "falling, but let go";
  EXPECT_EQ(FirstClosing(WithZeros({0, 2}, 1), 10), 0);
  EXPECT_EQ(FirstClosing(WithZeros({0, 2}, 1), 10, true), kNever);
  EXPECT_NEAR(FirstClosing(WithZeros({0, 2}, -1), 10), 2, 1e-15);
}

TEST(FirstClosing, RoundingBelowZeroNeitherRepeatsNorHidesAnImpact) {
  GapPolynomial up;
  up.c = {-1e-17, 1, -1, 0, 0};
  EXPECT_NEAR(FirstClosing(up, 10), 1, 1e-15);
  up.c = {-1e-17, 1, -1, 0, 1e-9};
  EXPECT_NEAR(FirstClosing(up, 10), 1, 1e-8);
  GapPolynomial down;
  down.c = {-1e-17, -1, 1, 0, 0};
  EXPECT_EQ(FirstClosing(down, 10), 0);
  down.c = {-1e-17, -1, 1, 0, 1e-9};
  EXPECT_EQ(FirstClosing(down, 10), 0);
}

TEST(FirstClosing, ATopBelowZeroCloses) {
  GapPolynomial g;
  g.c = {-1e-3 - 1e-9, 0.2, -10, 0, 0};  // top at 0.01, 1e-9 below zero
  EXPECT_NEAR(FirstClosing(g, 1), 0.01, 1e-12);
  g.c[4] = -1e-12;
  EXPECT_NEAR(FirstClosing(g, 1), 0.01, 1e-12);
}

// Every closing is a zero, and no sample before it lies below zero after one above.
TEST(FirstClosing, AgreesWithSampling) {
  std::mt19937 random(7);
  std::uniform_real_distribution<double> uniform(-1, 1);
  int closings = 0;
  for (int trial = 0; trial < 20000; ++trial) {
    GapPolynomial g;
    const int kind = trial % 4;
    if (kind == 3) g.degree = GapPolynomial::kLargestDegree;
    for (int k = 0; k <= (kind == 0 ? 2 : g.degree); ++k) g.c[k] = uniform(random) * std::pow(10, 2 * uniform(random));
    if (kind == 2) g.c[3] = 0;
    const double horizon = std::pow(10, uniform(random));
    const double s = FirstClosing(g, horizon);
    if (s < kNever) {
      ++closings;
      ASSERT_GE(s, 0);
      ASSERT_LE(s, horizon);
      if (g.c[0] > 0) {
        ASSERT_LE(std::abs(g(s)), 20 * Noise(g, s));
      }
    }
    const double end = std::min(s, horizon);
    bool above = g.c[0] > 0;
    for (int i = 1; i < 200; ++i) {
      const double at = end * i / 200;
      if (above) {
        ASSERT_GE(g(at), -20 * Noise(g, at)) << trial;
      }
      above = above || g(at) > 0;
    }
  }
  EXPECT_GT(closings, 5000);
}

TEST(StaysApart, IsNeverWrong) {
  std::mt19937 random(8);
  std::uniform_real_distribution<double> uniform(-1, 1);
  int apart = 0;
  for (int trial = 0; trial < 20000; ++trial) {
    GapPolynomial g;
    if (trial % 2 == 0) g.degree = GapPolynomial::kLargestDegree;
    for (int k = 0; k <= g.degree; ++k) g.c[k] = uniform(random);
    g.c[0] = std::abs(g.c[0]);
    if (!StaysApart(g, 0.7)) continue;
    ++apart;
    for (int i = 0; i <= 50; ++i) ASSERT_GT(g(0.7 * i / 50), 0);
  }
  EXPECT_GT(apart, 1000);
}

}  // namespace
}  // namespace saltus
