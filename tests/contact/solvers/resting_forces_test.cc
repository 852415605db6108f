// Forces of resting contacts against closed forms and against the conditions that define them.
#include "contact/solvers/resting_forces.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <random>
#include <vector>

namespace saltus {
namespace {

// With one coefficient of friction for all contacts.
RestingForces SolveWithFriction(double friction, const std::vector<double>& inverse_mass,
                                std::vector<Vec2d>& acceleration, std::vector<RestingContact>& contacts,
                                bool iteration_limited = false) {
  for (RestingContact& contact : contacts) contact.friction = friction;
  return SolveRestingForces(inverse_mass, acceleration, contacts, {}, iteration_limited);
}

// The conditions of resting_forces.h; tolerance in m/s^2 for contacts of unit mass.
void ExpectConditions(const std::vector<double>& inverse_mass, const std::vector<Vec2d>& given,
                      const std::vector<RestingContact>& contacts, const std::vector<Vec2d>& acceleration,
                      double tolerance) {
  std::vector<Vec2d> expected = given;
  for (const RestingContact& c : contacts) {
    const Vec2d force = c.normal_force * c.normal + c.tangential_force * Perpendicular(c.normal);
    expected[c.a] += inverse_mass[c.a] * force;
    if (c.b >= 0) expected[c.b] -= inverse_mass[c.b] * force;
  }
  for (std::size_t i = 0; i < given.size(); ++i) EXPECT_NEAR((expected[i] - acceleration[i]).norm(), 0, tolerance);
  for (const RestingContact& c : contacts) {
    const Vec2d b = c.b >= 0 ? Vec2d(acceleration[c.a] - acceleration[c.b]) : acceleration[c.a];
    const double apart = Dot(c.normal, b) + c.turning, along = Dot(Perpendicular(c.normal), b);
    const double bound = c.friction * c.normal_force;
    EXPECT_GE(c.normal_force, 0);
    EXPECT_GE(apart, -tolerance);
    EXPECT_NEAR(c.normal_force * apart, 0, tolerance * (1 + c.normal_force));
    if (c.sliding != 0) {
      EXPECT_NEAR(c.tangential_force, -c.sliding * bound, tolerance * (1 + bound));
      continue;
    }
    EXPECT_LE(std::abs(c.tangential_force), bound + tolerance * (1 + bound));
    // Friction acts against the sliding that begins.
    if (std::abs(along) > 1e-6) {
      EXPECT_NEAR(c.tangential_force, -std::copysign(bound, along), 1e-5 * (1 + bound));
    }
  }
}

// The first step: sweeps suffice.
TEST(RestingForces, OfADiscOnASlope) {
  const double g = 9.8, friction = 0.5;
  for (const double angle : {0.2, 0.6}) {
    const std::vector<double> inverse_mass = {0.25};
    const std::vector<Vec2d> given = {Vec2d(0, -g)};
    std::vector<Vec2d> acceleration = given;
    std::vector<RestingContact> contacts = {{.a = 0, .normal = {std::sin(angle), std::cos(angle)}, .mass = 4}};
    ASSERT_EQ(SolveWithFriction(friction, inverse_mass, acceleration, contacts), RestingForces::kFound);
    ExpectConditions(inverse_mass, given, contacts, acceleration, 1e-12);
    EXPECT_NEAR(contacts[0].normal_force, 4 * g * std::cos(angle), 1e-12);
    const double slides = std::max(0.0, g * (std::sin(angle) - friction * std::cos(angle)));
    EXPECT_NEAR(acceleration[0].norm(), slides, 1e-12);
  }
}

// Heavy discs on light ones: sweeps converge slowly, the linear system of the modes that they have reached is exact.
TEST(RestingForces, OfAStackOfGrowingMasses) {
  constexpr int kDiscs = 12;
  std::vector<double> mass(kDiscs), inverse_mass(kDiscs);
  for (int i = 0; i < kDiscs; ++i) inverse_mass[i] = 1 / (mass[i] = std::pow(3.0, i));
  const std::vector<Vec2d> given(kDiscs, Vec2d(0, -1));
  std::vector<Vec2d> acceleration = given;
  std::vector<RestingContact> contacts;
  for (int i = 0; i < kDiscs; ++i) {
    const double effective = i == 0 ? mass[0] : 1 / (inverse_mass[i] + inverse_mass[i - 1]);
    contacts.push_back({.a = i, .b = i - 1, .normal = {0, 1}, .mass = effective});
  }
  ASSERT_EQ(SolveWithFriction(0.3, inverse_mass, acceleration, contacts), RestingForces::kFound);
  double weight = 0;
  for (int i = kDiscs - 1; i >= 0; --i) {
    weight += mass[i];
    EXPECT_NEAR(contacts[i].normal_force, weight, 1e-9 * weight) << i;
    EXPECT_NEAR(contacts[i].tangential_force, 0, 1e-9 * weight) << i;
    EXPECT_NEAR(acceleration[i].norm(), 0, 1e-9);
  }
}

// A disc that slides along a floor and a wall: the friction of each pushes it into the other, f = m g + mu^2 f on
// the floor. From mu = 1 on it is jammed.
TEST(RestingForces, JamWhereFrictionPushesADiscIntoBothWalls) {
  const std::vector<double> inverse_mass = {0.5};
  for (const double friction : {0.3, 0.9, 1.1, 3.0}) {
    const std::vector<Vec2d> given = {Vec2d(0, -9.8)};
    std::vector<Vec2d> acceleration = given;
    std::vector<RestingContact> contacts = {{.a = 0, .normal = {0, 1}, .mass = 2, .sliding = 1},
                                            {.a = 0, .normal = {-1, 0}, .mass = 2, .sliding = -1}};
    const RestingForces result = SolveWithFriction(friction, inverse_mass, acceleration, contacts);
    if (friction > 1) {
      EXPECT_EQ(result, RestingForces::kJammed) << friction;
      continue;
    }
    ASSERT_EQ(result, RestingForces::kFound) << friction;
    ExpectConditions(inverse_mass, given, contacts, acceleration, 1e-11);
    EXPECT_NEAR(contacts[0].normal_force, 2 * 9.8 / (1 - friction * friction), 1e-9);
    EXPECT_NEAR(contacts[1].normal_force, friction * contacts[0].normal_force, 1e-9);
  }
}

// Random contacts of a few discs, more than these can move in: whatever step finds the forces, they obey the
// conditions, with one coefficient of friction or several. Contacts that do not slide always have some.
TEST(RestingForces, OfRandomContacts) {
  std::mt19937 random(7);
  std::uniform_real_distribution<double> uniform(-1, 1);
  int active = 0;
  for (int trial = 0; trial < 2000; ++trial) {
    const int discs = 1 + trial % 4, n = 1 + static_cast<int>(random() % 8);
    const double friction = trial % 3 == 0 ? 0.0 : trial % 3 == 1 ? 0.2 : 0.9;
    std::vector<double> inverse_mass;
    std::vector<Vec2d> given;
    for (int i = 0; i < discs; ++i) {
      inverse_mass.push_back(1 + 0.5 * uniform(random));
      given.emplace_back(uniform(random), uniform(random));
    }
    std::vector<RestingContact> contacts;
    bool slides = false;
    for (int k = 0; k < n; ++k) {
      const double angle = 3.2 * uniform(random);
      const int a = static_cast<int>(random() % discs), b = static_cast<int>(random() % (discs + 1)) - 1;
      RestingContact c{.a = a, .b = b == a ? -1 : b, .normal = {std::cos(angle), std::sin(angle)}};
      c.mass = 1 / (inverse_mass[a] + (c.b >= 0 ? inverse_mass[c.b] : 0.0));
      c.friction = trial % 7 != 0 ? friction : k % 3 == 0 ? 0.0 : k % 3 == 1 ? 0.2 : 0.9;
      if (trial % 5 == 0 && k == 0) c.sliding = uniform(random) > 0 ? 1 : -1;
      slides = slides || c.sliding != 0;
      contacts.push_back(c);
    }
    std::vector<Vec2d> acceleration = given;
    const RestingForces result = SolveRestingForces(inverse_mass, acceleration, contacts);
    if (!slides) {
      ASSERT_EQ(result, RestingForces::kFound) << trial;
    }
    if (result != RestingForces::kFound) continue;
    ExpectConditions(inverse_mass, given, contacts, acceleration, 1e-8);
    for (const RestingContact& c : contacts) active += c.normal_force > 1e-6;
    if (HasFailure()) FAIL() << trial;
  }
  EXPECT_GT(active, 2000);
}

// With limited iterations many contacts get a few pivots: enough for a row, whose contacts are all active.
TEST(RestingForces, WithLimitedIterations) {
  constexpr int kDiscs = 40;
  const std::vector<double> inverse_mass(kDiscs, 1.0);
  std::vector<RestingContact> contacts;
  for (int i = 0; i < kDiscs; ++i) {
    contacts.push_back({.a = i, .b = i - 1, .normal = {0, 1}, .mass = i == 0 ? 1.0 : 0.5});
  }
  std::vector<Vec2d> acceleration(kDiscs, Vec2d(0, -1));
  EXPECT_EQ(SolveWithFriction(0, inverse_mass, acceleration, contacts, /*iteration_limited=*/true),
            RestingForces::kFound);
  EXPECT_NEAR(contacts[0].normal_force, kDiscs, 1e-8);
  // Forces that alternate along the row close and open its contacts one after the other.
  for (int i = 0; i < kDiscs; ++i) acceleration[i] = Vec2d(0, std::sin(1.0 + i * i));
  const std::vector<Vec2d> given = acceleration;
  std::vector<RestingContact> again = contacts;
  const bool limited = SolveWithFriction(0, inverse_mass, acceleration, again, true) == RestingForces::kFound;
  if (limited) ExpectConditions(inverse_mass, given, again, acceleration, 1e-9);
  acceleration = given;
  ASSERT_EQ(SolveWithFriction(0, inverse_mass, acceleration, contacts), RestingForces::kFound);
  ExpectConditions(inverse_mass, given, contacts, acceleration, 1e-9);
}

// Discs in a row that rest on a wall: forces known in closed form, however long the row.
TEST(RestingForces, OfALongRow) {
  for (int n : {1, 5, 40, 150}) {
    const std::vector<double> inverse_mass(n, 0.5);
    std::vector<Vec2d> acceleration(n, Vec2d(0, -9.8));
    std::vector<RestingContact> contacts;
    for (int i = 0; i < n; ++i) {
      contacts.push_back({.a = i, .b = i - 1, .normal = {0, 1}, .mass = i == 0 ? 2.0 : 1.0});
    }
    EXPECT_EQ(SolveWithFriction(0.4, inverse_mass, acceleration, contacts), RestingForces::kFound);
    for (int i = 0; i < n; ++i) {
      EXPECT_NEAR(contacts[i].normal_force, 2 * 9.8 * (n - i), 1e-8 * n) << n;
      EXPECT_NEAR(acceleration[i].norm(), 0, 1e-8) << n;
    }
  }
}

// A pyramid beside a wall, where more contacts stick than there are ways to move: they agree but for the small speeds
// and gaps of the state.
TEST(RestingForces, OfContactsThatDependOnEachOther) {
  const std::vector<double> inverse_mass = {2, 2.9405595287085524, 2, 2, 0.80988643956465256, 0.8290179952495107};
  std::vector<Vec2d> acceleration = {Vec2d(0, -0.30625000000000002),
                                     Vec2d(0.11354292650971652, -0.27246960040545332),
                                     Vec2d(-0.037752237636595964, -0.18532279672799634),
                                     Vec2d(0, -0.30625000000000002),
                                     Vec2d(0, -0.30625000000000002),
                                     Vec2d(-0.045899272689512591, -0.34992137339382406)};
  std::vector<RestingContact> contacts = {
      {.a = 0,
       .b = 3,
       .normal = {-0.49999999995838013, -0.86602540380846793},
       .mass = 0.25,
       .turning = 0,
       .sliding = 0},
      {.a = 0, .b = 1, .normal = {-1, 0}, .mass = 0.20240622427261734, .turning = 0, .sliding = 0},
      {.a = 1,
       .b = 3,
       .normal = {0.50000000006673151, -0.8660254037459113},
       .mass = 0.20240622427261734,
       .turning = 1.2128228446096791e-12,
       .sliding = 1},
      {.a = 1,
       .b = 4,
       .normal = {-0.53620829536955705, -0.84408569705739822},
       .mass = 0.26663495713829038,
       .turning = 0.0066189722397978074,
       .sliding = -1},
      {.a = 2,
       .b = 4,
       .normal = {0.53620829536955728, -0.84408569705739811},
       .mass = 0.3558862685407792,
       .turning = 0.0066189722397978074,
       .sliding = 1},
      {.a = 3,
       .b = 5,
       .normal = {-0.53620829514440893, -0.84408569720042426},
       .mass = 0.3534795472065575,
       .turning = 0.0066166674779368434,
       .sliding = -1},
      {.a = 0, .b = -1, .normal = {0, 1}, .mass = 0.5, .turning = 0, .sliding = 0},
      {.a = 0, .b = -1, .normal = {1, 0}, .mass = 0.5, .turning = 0, .sliding = 0},
      {.a = 1, .b = -1, .normal = {0, 1}, .mass = 0.34007133344421164, .turning = 0, .sliding = -1},
      {.a = 2, .b = -1, .normal = {0, 1}, .mass = 0.5, .turning = 0, .sliding = -1},
  };
  const std::vector<Vec2d> given = acceleration;
  const double friction = 0.038954626768827438;
  EXPECT_EQ(SolveWithFriction(friction, inverse_mass, acceleration, contacts), RestingForces::kFound);
  ExpectConditions(inverse_mass, given, contacts, acceleration, 1e-9);
}

// From a pile that settles: sweeps and changes of one mode after the other go in circles.
TEST(RestingForces, WherePivotsGoInCircles) {
  struct Given {
    int a, b;
    Vec2d normal;
    double turning;
    int sliding;
  };
  const Given given[] = {{3, -1, {0, 1}, 0, 1},
                         {2, 3, {-0.999141147165, -0.0414363130713}, 0, 0},
                         {3, 8, {-0.384442831425, -0.923148801313}, 0.0001673, -1},
                         {8, 9, {-0.976050506125, -0.217544040354}, 4.1297e-05, -1},
                         {8, 11, {0.40784879583, -0.91304948373}, 4.6645e-06, 1},
                         {11, 13, {-0.98281718622, -0.184581630911}, 4.5968e-05, -1},
                         {2, -1, {0, 1}, 0, 1},
                         {7, 11, {-0.999628649801, -0.0272499999502}, 1.5909e-06, 1},
                         {7, 12, {0.951741551797, -0.306900665662}, 3.3409e-05, -1},
                         {10, 12, {-0.803457612871, -0.595361960759}, 3.6899e-06, -1},
                         {4, 10, {-0.925536138173, -0.378659288723}, 1.7768e-08, -1},
                         {5, 10, {-0.101449654262, -0.994840674505}, 8.8756e-10, 1},
                         {4, -1, {1, 0}, 0, 0},
                         {0, 4, {0.00281451883018, -0.999996039234}, 4.0671e-12, -1},
                         {0, 5, {-0.838789944973, -0.544455166393}, 2.1887e-08, -1},
                         {1, 5, {0.806563216454, -0.59114784772}, 2.4621e-08, 1},
                         {1, 6, {-0.197074445098, -0.9803885266}, 9.0301e-05, 1},
                         {0, -1, {0, 1}, 0, 1},
                         {0, -1, {1, 0}, 0, -1},
                         {1, -1, {0, 1}, 0, -1}};
  const double friction = 0.1;
  const std::vector<double> inverse_mass(14, 1.0);
  std::vector<Vec2d> acceleration(14, Vec2d(0, -3e-4));
  std::vector<RestingContact> contacts;
  for (const Given& c : given) {
    contacts.push_back({.a = c.a,
                        .b = c.b,
                        .normal = c.normal.normalized(),
                        .mass = c.b < 0 ? 1 : 0.5,
                        .turning = c.turning,
                        .sliding = c.sliding});
  }
  ASSERT_EQ(SolveWithFriction(friction, inverse_mass, acceleration, contacts), RestingForces::kFound);
  ExpectConditions(inverse_mass, std::vector<Vec2d>(14, Vec2d(0, -3e-4)), contacts, acceleration, 1e-15);
}

TEST(RestingForces, SayWhereTheyAreNotFound) {
  const std::vector<double> inverse_mass = {1};
  std::vector<Vec2d> acceleration = {Vec2d(0, std::numeric_limits<double>::quiet_NaN())};
  std::vector<RestingContact> contacts = {{.a = 0, .normal = {0, 1}, .mass = 1}};
  EXPECT_EQ(SolveWithFriction(0, inverse_mass, acceleration, contacts), RestingForces::kNotFound);
}

}  // namespace
}  // namespace saltus
