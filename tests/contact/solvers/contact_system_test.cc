// Sparse systems of contact against the dense pseudo-inverse.
#include "contact/solvers/contact_system.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>
#include <utility>

namespace saltus {
namespace {

// A pile in rows of equal discs on a ground: of some height, and as wide.
struct Pile {
  explicit Pile(int size) {
    const auto disc = [&](int level, int i) { return level * size + i; };
    std::mt19937 random(1);
    std::uniform_real_distribution<double> uniform(0.5, 2);
    for (int i = 0; i < size * size; ++i) inverse_mass.push_back(uniform(random));
    inverse_mass[size + 1] = 0;  // this one is fixed
    const auto add = [&](int a, int b, double angle) {
      const Vec2d normal(std::cos(angle), std::sin(angle));
      rows.push_back({a, b, normal, normal});
    };
    for (int level = 0; level < size; ++level) {
      for (int i = 0; i < size; ++i) {
        if (level == 0) add(disc(level, i), -1, M_PI / 2);
        if (i + 1 < size) add(disc(level, i), disc(level, i + 1), M_PI);
        if (level + 1 < size) add(disc(level, i), disc(level + 1, i), -M_PI / 3);
        if (level + 1 < size && i + 1 < size) add(disc(level, i + 1), disc(level + 1, i), -2 * M_PI / 3);
      }
    }
  }
  int size() const { return static_cast<int>(rows.size()); }

  std::vector<ContactRow> rows;
  std::vector<double> inverse_mass;
};

std::vector<double> DensePseudoInverse(const Pile& pile) {
  const int n = pile.size();
  std::vector<double> matrix(n * n);
  for (int i = 0; i < n; ++i) {
    for (int j = 0; j < n; ++j) matrix[i * n + j] = Coupling(pile.rows[i], pile.rows[j], pile.inverse_mass);
  }
  PseudoInvert(n, matrix);
  return matrix;
}

// Returns the measurements of some motion of the discs, which forces can therefore undo.
std::vector<double> Measured(const Pile& pile, unsigned seed, bool along_push) {
  std::mt19937 random(seed);
  std::normal_distribution<double> normal;
  std::vector<Vec2d> moved;
  for (double inverse_mass : pile.inverse_mass) {
    const Vec2d motion(normal(random), normal(random));
    moved.push_back(inverse_mass > 0 ? motion : Vec2d(0, 0));
  }
  std::vector<double> measured;
  for (const ContactRow& row : pile.rows) {
    const Vec2d relative = row.b < 0 ? moved[row.a] : Vec2d(moved[row.a] - moved[row.b]);
    measured.push_back(Dot(along_push ? row.push : row.measured, relative));
  }
  return measured;
}

void ExpectAsDense(const Pile& pile, const ContactSystem& system, double tolerance) {
  const std::vector<double> inverse = DensePseudoInverse(pile);
  const int n = pile.size();
  for (const bool transposed : {false, true}) {
    const std::vector<double> given = Measured(pile, 7, transposed);
    std::vector<double> found = given;
    EXPECT_TRUE(transposed ? system.SolveTransposed(found) : system.Solve(found)) << "sparsely";
    double largest = 0;
    for (int i = 0; i < n; ++i) {
      double expected = 0;
      for (int j = 0; j < n; ++j) expected += inverse[transposed ? j * n + i : i * n + j] * given[j];
      largest = std::max(largest, std::abs(expected));
      EXPECT_NEAR(found[i], expected, tolerance * std::max(1.0, largest)) << i << (transposed ? " transposed" : "");
    }
  }
}

TEST(ContactSystem, OfAPileWhoseContactsDependOnEachOther) {
  const Pile pile(6);
  ASSERT_GT(pile.size(), 2 * 36) << "more contacts than directions in which discs can move";
  ExpectAsDense(pile, ContactSystem(pile.rows, pile.inverse_mass), 1e-6);
}

TEST(ContactSystem, OfAStack) {
  Pile stack(1);
  stack.rows.resize(1);
  stack.inverse_mass.assign(60, 1.0);
  for (int i = 0; i + 1 < 60; ++i) stack.rows.push_back({i, i + 1, {0, -1}, {0, -1}});
  ExpectAsDense(stack, ContactSystem(stack.rows, stack.inverse_mass), 1e-10);
}

TEST(ContactSystem, WithForcesThatDoNotActAlongWhatIsMeasured) {
  Pile stack(1);
  stack.rows.resize(1);
  stack.inverse_mass.assign(40, 1.0);
  for (int i = 0; i + 1 < 40; ++i) {
    const double angle = -1 - 0.01 * i;
    stack.rows.push_back({i, i + 1, {std::cos(angle), std::sin(angle)}, {0, 0}});
  }
  for (std::size_t i = 0; i < stack.rows.size(); ++i) {
    ContactRow& row = stack.rows[i];
    row.push = row.measured + (i % 3 == 0 ? 0.3 : -0.2) * Perpendicular(row.measured);
  }
  ExpectAsDense(stack, ContactSystem(stack.rows, stack.inverse_mass), 1e-10);
}

// Two rows measure the same along pushes that differ: nothing is left of the matrix's symmetry, and no force undoes
// what they do not measure alike.
TEST(ContactSystem, SaysWhereOnlyADenseMatrixWouldDo) {
  const std::vector<ContactRow> rows = {{0, -1, {0, 1}, {0, 1}}, {0, -1, {0, 1}, {0.5, 1}}};
  const std::vector<double> inverse_mass = {1};
  const ContactSystem system(rows, inverse_mass);
  std::vector<double> x = {1, -1};
  EXPECT_FALSE(system.SolveOnlySparse(x));
  EXPECT_EQ(x, (std::vector<double>{1, -1}));
  EXPECT_FALSE(system.Solve(x));
  x = {2, 2};
  EXPECT_TRUE(system.SolveOnlySparse(x));
  EXPECT_NEAR(x[0] + x[1], 2, 1e-9);
}

TEST(ContactSystem, BorrowsAFactorizationOfNearlyTheSame) {
  Pile stack(1);
  stack.rows.resize(1);
  stack.inverse_mass.assign(40, 1.0);
  for (int i = 0; i + 1 < 40; ++i) stack.rows.push_back({i, i + 1, {0, -1}, {0, -1}});
  const ContactSystem first(stack.rows, stack.inverse_mass);
  ExpectAsDense(stack, first, 1e-10);
  for (ContactRow& row : stack.rows) {
    row.measured = row.push = Vec2d(row.measured + 3e-7 * Perpendicular(row.measured)).normalized();
  }
  ExpectAsDense(stack, ContactSystem(stack.rows, stack.inverse_mass, &first), 1e-10);
  // Others have one of their own.
  for (std::size_t i = 0; i < stack.rows.size(); i += 2) stack.rows[i].measured = stack.rows[i].push = {0.6, -0.8};
  ExpectAsDense(stack, ContactSystem(stack.rows, stack.inverse_mass, &first), 1e-10);
}

// A cache keeps the factors of the last systems: of those that are the same to the bit only.
TEST(ContactSystem, DoesNotDependOnWhatWasSolvedBefore) {
  ContactSystem::Cache cache;
  const auto solve = [](const Pile& pile, ContactSystem::Cache* kept) {
    std::vector<double> x = Measured(pile, 1, false);
    EXPECT_TRUE(ContactSystem(pile.rows, pile.inverse_mass, /*like=*/nullptr, kept).Solve(x));
    return x;
  };
  const auto nearly = [](double turned, double heavier) {
    Pile pile(6);
    pile.inverse_mass[0] /= 1 + heavier;
    for (ContactRow& row : pile.rows) {
      const double angle = std::atan2(row.measured[1], row.measured[0]) + turned;
      row.measured = row.push = Vec2d(std::cos(angle), std::sin(angle));
    }
    return pile;
  };
  for (int turn = 0; turn < 3; ++turn) {
    for (const auto& [turned, heavier] : std::vector<std::pair<double, double>>{
             {0, 0}, {1e-9, 0}, {0, 0}, {1e-3, 0}, {1e-3, 1e-3}, {0, 1e-3}, {0, 1e-9}, {2e-3, 0}, {2e-3, 1}, {0, 0}}) {
      const Pile pile = nearly(turned, heavier);
      EXPECT_EQ(solve(pile, &cache), solve(pile, nullptr)) << turned << " " << heavier;
    }
  }
}

}  // namespace
}  // namespace saltus
