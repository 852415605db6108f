// Impacts at the same time that share discs: reported where their order decides, and only there.
//
// What each order leads to is worked out here by itself, on the velocities alone, from the impulse that event.h states.
#include "contact/event/event_ties.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <numeric>

#include "contact/event/event_run.h"
#include "saltus/simulate/events.h"

namespace saltus {
namespace {

using testing::EventRun;
using testing::StartOf;

constexpr double kImpactTime = 0.5;  // s
constexpr double kClear = 1e-3;      // m/s: outcomes either differ by more,
constexpr double kSame = 1e-5;       // or by less

Vec2d Along(double angle) { return {std::cos(angle), std::sin(angle)}; }

// A striker and what it meets at kImpactTime at the origin, each in its own direction.
struct Target {
  double angle = 0;     // rad, from the striker to it
  bool plane = false;   // else a disc
  bool fixed = false;   // a disc that never moves
  double mass = 1;      // kg
  double radius = 0.1;  // m
  Vec2d velocity = Vec2d::Zero();
};
Scene Star(const std::vector<Target>& targets, double restitution, double friction) {
  Scene scene;
  scene.name = "star";
  scene.duration = 1;
  scene.steps = 1000;
  scene.contact = {.restitution = restitution, .friction = friction};
  const Vec2d velocity(1.3, 0.2);
  scene.bodies = {{.name = "striker", .radius = 0.1, .mass = 1.2, .position = -kImpactTime * velocity}};
  scene.bodies[0].velocity = velocity;
  for (const Target& target : targets) {
    const Vec2d direction = Along(target.angle);
    if (target.plane) {
      scene.planes.push_back({"plane" + std::to_string(scene.planes.size()), 0.1 * direction, -direction});
      continue;
    }
    Body body{.name = "disc" + std::to_string(scene.num_bodies()), .radius = target.radius, .mass = target.mass};
    body.fixed = target.fixed;
    if (!target.fixed) body.velocity = target.velocity;
    body.position = (0.1 + target.radius) * direction - kImpactTime * body.velocity;
    scene.bodies.push_back(body);
  }
  scene.objective.terminal = {{.body = 0, .target = {1, 1}}};
  return scene;
}

// ---------------------------------------------------------------------------------------------------------------------
// The orders, by hand.

struct Contact {
  int a, b;      // b = -1: a plane
  Vec2d normal;  // towards a
};
using Velocities = std::vector<Vec2d>;

// The contacts that touch when every disc has flown for kImpactTime.
std::vector<Contact> ContactsAtImpact(const Scene& scene) {
  const auto at = [&](int i) -> Vec2d { return scene.bodies[i].position + kImpactTime * scene.bodies[i].velocity; };
  std::vector<Contact> contacts;
  for (int i = 0; i < scene.num_bodies(); ++i) {
    for (int j = i + 1; j < scene.num_bodies(); ++j) {
      const Vec2d d = at(i) - at(j);
      if (scene.bodies[i].fixed && scene.bodies[j].fixed) continue;
      if (d.norm() - scene.bodies[i].radius - scene.bodies[j].radius < 1e-9) contacts.push_back({i, j, d.normalized()});
    }
    for (const Plane& plane : scene.planes) {
      const Vec2d n = plane.normal.normalized();
      if (!scene.bodies[i].fixed && n.dot(at(i) - plane.point) - scene.bodies[i].radius < 1e-9) {
        contacts.push_back({i, -1, n});
      }
    }
  }
  return contacts;
}

Velocities Outcome(const Scene& scene, const std::vector<Contact>& contacts, const std::vector<int>& order) {
  Velocities v;
  for (const Body& body : scene.bodies) v.push_back(body.velocity);
  for (int count = 0; count < 1000; ++count) {
    bool any = false;
    for (int k : order) {
      const auto& [a, b, n] = contacts[k];
      const double inverse_a = scene.bodies[a].fixed ? 0 : 1 / scene.bodies[a].mass;
      const double inverse_b = b < 0 || scene.bodies[b].fixed ? 0 : 1 / scene.bodies[b].mass;
      const Vec2d w = b < 0 ? v[a] : Vec2d(v[a] - v[b]), t(-n[1], n[0]);
      if (n.dot(w) > -1e-9) continue;
      const double mass = 1 / (inverse_a + inverse_b);
      const double normal = -(1 + scene.contact.restitution) * mass * n.dot(w);
      const double bound = scene.contact.friction * normal;
      const Vec2d impulse = normal * n + std::clamp(-mass * t.dot(w), -bound, bound) * t;
      v[a] += inverse_a * impulse;
      if (b >= 0) v[b] -= inverse_b * impulse;
      any = true;
      break;
    }
    if (!any) return v;
  }
  ADD_FAILURE() << "no end";
  return v;
}

double Distance(const Velocities& a, const Velocities& b) {
  double distance = 0;
  for (std::size_t i = 0; i < a.size(); ++i) distance = std::max(distance, (a[i] - b[i]).norm());
  return distance;
}

std::vector<Velocities> OutcomesOfAllOrders(const Scene& scene) {
  const std::vector<Contact> contacts = ContactsAtImpact(scene);
  std::vector<int> order(contacts.size());
  std::iota(order.begin(), order.end(), 0);
  std::vector<Velocities> outcomes;
  do {
    outcomes.push_back(Outcome(scene, contacts, order));
  } while (std::next_permutation(order.begin(), order.end()));
  return outcomes;
}

double LargestDistance(const std::vector<Velocities>& outcomes) {
  double largest = 0;
  for (const Velocities& outcome : outcomes) largest = std::max(largest, Distance(outcome, outcomes[0]));
  return largest;
}

bool IsAmong(const std::vector<Velocities>& outcomes, const Velocities& v) {
  return std::any_of(outcomes.begin(), outcomes.end(), [&](const Velocities& o) { return Distance(o, v) < 1e-5; });
}

Velocities VelocitiesAt(const EventRun& run, int step) {
  const std::vector<double> x = run.State(step);
  Velocities v;
  for (std::size_t i = 0; i < x.size(); i += 4) v.emplace_back(x[i + 2], x[i + 3]);
  return v;
}
int StepAfterImpact(const Scene& scene) { return scene.steps / 2 + 1; }

// Returns the scene with its bodies and planes in another order.
Scene Permuted(const Scene& scene, const std::vector<int>& bodies, bool planes_backwards) {
  Scene other = scene;
  for (std::size_t i = 0; i < bodies.size(); ++i) other.bodies[i] = scene.bodies[bodies[i]];
  if (planes_backwards) std::reverse(other.planes.begin(), other.planes.end());
  for (TerminalTerm& term : other.objective.terminal) {
    term.body = static_cast<int>(std::find(bodies.begin(), bodies.end(), term.body) - bodies.begin());
  }
  return other;
}

std::vector<std::string> SortedBodies(const Tie& tie) {
  std::vector<std::string> bodies = tie.bodies;
  std::sort(bodies.begin(), bodies.end());
  return bodies;
}

std::vector<std::string> NamesOf(const Scene& scene) {
  std::vector<std::string> names;
  for (const Body& body : scene.bodies) names.push_back(body.name);
  for (const Plane& plane : scene.planes) names.push_back(plane.name);
  std::sort(names.begin(), names.end());
  return names;
}

// Reported exactly if the outcomes differ, whatever the order of the scene's lines; and the orders that the simulator
// can be told to take lead to all outcomes.
void ExpectRightVerdict(const Scene& scene, int* ambiguous, int* agreeing) {
  const std::vector<Velocities> outcomes = OutcomesOfAllOrders(scene);
  const double spread = LargestDistance(outcomes);
  ASSERT_TRUE(spread > kClear || spread < kSame) << spread;
  const bool differ = spread > kClear;
  ++*(differ ? ambiguous : agreeing);

  std::vector<int> bodies(scene.bodies.size());
  std::iota(bodies.begin(), bodies.end(), 0);
  do {
    for (bool backwards : {false, true}) {
      const EventRun run(Permuted(scene, bodies, backwards));
      const std::vector<Tie> ties = TiesOf(run.simulator);
      ASSERT_EQ(ties.size(), differ ? 1u : 0u);
      if (!differ) continue;
      EXPECT_NEAR(ties[0].time, kImpactTime, 1e-12);
      EXPECT_EQ(SortedBodies(ties[0]), NamesOf(scene));
    }
  } while (std::next_permutation(bodies.begin(), bodies.end()));

  EventRun run(scene);
  EXPECT_TRUE(IsAmong(outcomes, VelocitiesAt(run, StepAfterImpact(scene))));
  std::vector<Velocities> taken;
  for (int order = 1; order <= static_cast<int>(outcomes.size()); ++order) {
    run.simulator.set_tie_order(order);
    ASSERT_TRUE(run.simulator.Rollout(StartOf(scene), run.control));
    taken.push_back(VelocitiesAt(run, StepAfterImpact(scene)));
    EXPECT_TRUE(IsAmong(outcomes, taken.back())) << order;
  }
  for (const Velocities& outcome : outcomes) EXPECT_TRUE(IsAmong(taken, outcome));
}

TEST(EventTies, AllOrdersOfUpToFourContacts) {
  const double walls[] = {1.45, -1.15}, angles[] = {0.4, -0.1, -0.7, 1.0};
  int ambiguous = 0, agreeing = 0;
  for (int n = 2; n <= 4; ++n) {
    for (int planes = 0; planes <= 2; ++planes) {
      for (double restitution : {0.0, 0.6, 1.0}) {
        for (double friction : {0.0, 0.3}) {
          std::vector<Target> targets;
          for (int i = 0; i < n; ++i) {
            const bool wall = i < planes;
            Target target{.angle = wall ? walls[i] : angles[i - planes], .plane = wall};
            target.fixed = i == 3 && planes == 0;
            target.mass = 0.7 + 0.5 * i;
            target.radius = 0.015 + 0.004 * i;
            if (i % 2 == 1 && planes == 0) target.velocity = Vec2d(-0.3, 0.1);
            targets.push_back(target);
          }
          SCOPED_TRACE(::testing::Message()
                       << n << " contacts, " << planes << " planes, e = " << restitution << ", mu = " << friction);
          ExpectRightVerdict(Star(targets, restitution, friction), &ambiguous, &agreeing);
        }
      }
    }
  }
  EXPECT_GE(ambiguous, 40);
}

// One that strikes two discs of its own size and mass, with a gap between them, of which it comes closer to none.
Scene BilliardTriangle(double restitution, double friction, double gap = 0, double turned = 0,
                       const Vec2d& origin = {0, 0}) {
  const double r = 0.1, half = r + 0.5 * gap, height = std::sqrt(4 * r * r - half * half);
  Scene scene;
  scene.name = "triangle";
  scene.duration = 1;
  scene.steps = 40;
  scene.contact = {.restitution = restitution, .friction = friction};
  const Vec2d x = Along(turned), y = Perpendicular(x);
  const auto put = [&](const char* name, double px, double py) {
    scene.bodies.push_back({.name = name, .radius = r, .mass = 1, .position = origin + px * x + py * y});
  };
  put("striker", -height - 0.75, 0);
  put("left", 0, half);
  put("right", 0, -half);
  scene.bodies[0].velocity = 1.5 * x;
  scene.objective.terminal = {{.body = 1, .target = {0, 0}}};
  return scene;
}

TEST(EventTies, BilliardTriangle) {
  int ambiguous = 0, agreeing = 0;
  for (double restitution : {0.3, 1.0}) {
    for (double friction : {0.0, 0.2}) {
      ExpectRightVerdict(BilliardTriangle(restitution, friction), &ambiguous, &agreeing);
    }
  }
  EXPECT_EQ(ambiguous, 4);
}

// Rounding breaks the symmetry of these, one way or the other.
TEST(EventTies, TurnedAndMovedFarAway) {
  for (int i = 0; i < 48; ++i) {
    for (const Vec2d& origin : {Vec2d(0, 0), Vec2d(3, -7), Vec2d(1e5, 7e4)}) {
      const EventRun run(BilliardTriangle(1, 0, 0.01, 0.1 + i * std::numbers::pi / 24, origin));
      const std::vector<Tie> ties = TiesOf(run.simulator);
      ASSERT_EQ(ties.size(), 1u) << i << " at " << origin.transpose();
      EXPECT_EQ(ties[0].bodies, (std::vector<std::string>{"striker", "left", "right"}));
    }
  }
}

// Also where the impact is on a node of the grid, and so on either side of it.
TEST(EventTies, OnEveryGrid) {
  for (int steps = 1; steps <= 128; ++steps) {
    Scene scene = BilliardTriangle(1, 0, 0.01, 0.3, {0.1, 0.2});
    scene.steps = steps;
    const EventRun run(scene);
    const std::vector<Tie> ties = TiesOf(run.simulator);
    ASSERT_EQ(ties.size(), 1u) << steps;
    EXPECT_NEAR(ties[0].time, 0.5, 1e-12);
  }
}

TEST(EventTies, TheFirstImpactBeforeANodeAndTheSecondBehindIt) {
  const double shift = 1e-10;  // m
  for (double earlier : {0.2, 0.5, 0.8, 0.95}) {
    Scene scene = BilliardTriangle(1, 0, 0.01);
    scene.steps = 100;
    scene.bodies[0].position += Vec2d(earlier * shift, 0);
    scene.bodies[2].position += Vec2d(shift, 0);  // met later
    const EventRun run(scene);
    std::vector<int> steps;
    for (const StepTouch& at : run.simulator.touches()) steps.push_back(at.step);
    ASSERT_GE(steps.size(), 2u);
    EXPECT_EQ(steps[0], 49);
    EXPECT_GE(steps.back(), 50);
    EXPECT_EQ(TiesOf(run.simulator).size(), 1u) << earlier;
  }
}

TEST(EventTies, NotIfOneClearlyComesFirst) {
  for (double later : {1e-7, 1e-5, 1e-3}) {
    for (int which : {1, 2}) {
      Scene scene = BilliardTriangle(1, 0, 0.01);
      scene.bodies[which].position[0] += later;
      EXPECT_TRUE(TiesOf(EventRun(scene).simulator).empty()) << later;
    }
  }
}

// Equal discs in a row that touch.
Scene Cradle(int discs, double restitution) {
  Scene scene;
  scene.name = "cradle";
  scene.duration = 1;
  scene.steps = 20;
  scene.contact.restitution = restitution;
  for (int i = 0; i < discs; ++i) {
    scene.bodies.push_back({.name = "d" + std::to_string(i), .radius = 0.1, .mass = 1, .position = {0.2 * i, 0}});
  }
  scene.bodies[0].position[0] -= 0.5;
  scene.bodies[0].velocity = {1, 0};
  return scene;
}

TEST(EventTies, NothingIsSaidOfACradle) {
  for (int discs = 3; discs <= 8; ++discs) {
    const EventRun run(Cradle(discs, 1));
    EXPECT_TRUE(TiesOf(run.simulator).empty()) << discs;
    EXPECT_NEAR(run.End()[4 * (discs - 1) + 2], 1, 1e-12);
  }
  // Struck from both ends, and by two discs at once.
  Scene both = Cradle(5, 1);
  both.bodies[4].position[0] += 0.5;
  both.bodies[4].velocity = {-1, 0};
  EXPECT_TRUE(TiesOf(EventRun(both).simulator).empty());
  Scene two = Cradle(6, 1);
  two.bodies[1].position[0] -= 0.5;
  two.bodies[1].velocity = {1, 0};
  EXPECT_TRUE(TiesOf(EventRun(two).simulator).empty());
  // Three discs pass impacts to and fro in one order only; of more, impacts that are not elastic come in several.
  EXPECT_TRUE(TiesOf(EventRun(Cradle(3, 0.5)).simulator).empty());
  const std::vector<Tie> ties = TiesOf(EventRun(Cradle(4, 0.5)).simulator);
  ASSERT_EQ(ties.size(), 1u);
  EXPECT_EQ(ties[0].num_contacts, 3);
}

// A disc that flies into a corner of this angle, and meets both walls at once.
Scene Corner(double angle, double turned, double restitution, double friction) {
  const Vec2d one = Along(turned), other = Along(turned + std::numbers::pi - angle);
  Scene scene;
  scene.name = "corner";
  scene.duration = 1;
  scene.steps = 33;
  scene.contact = {.restitution = restitution, .friction = friction};
  const Vec2d velocity = -1.1 * one - 0.8 * other;
  scene.bodies = {{.name = "ball", .radius = 0.2, .mass = 2}};
  scene.bodies[0].velocity = velocity;
  scene.bodies[0].position = -kImpactTime * velocity;
  scene.planes = {{"one", -0.2 * one, one}, {"other", -0.2 * other, other}};
  return scene;
}

TEST(EventTies, ARightAngledFrictionlessCornerIsSilent) {
  const double right = std::numbers::pi / 2;
  int ambiguous = 0, agreeing = 0;
  for (double turned : {0.0, 0.4, 2.0}) {
    for (double restitution : {0.0, 0.5, 1.0})
      ExpectRightVerdict(Corner(right, turned, restitution, 0), &ambiguous, &agreeing);
    EXPECT_EQ(ambiguous, 0);
  }
  EXPECT_EQ(agreeing, 9);
  for (double turned : {0.0, 0.4, 2.0}) {
    for (double restitution : {0.5, 1.0}) {
      ExpectRightVerdict(Corner(right, turned, restitution, 0.3), &ambiguous, &agreeing);
      ExpectRightVerdict(Corner(0.7 * right, turned, restitution, 0), &ambiguous, &agreeing);
    }
  }
  EXPECT_EQ(ambiguous, 12);
}

TEST(EventTies, PairsThatShareNothingOrAFixedDisc) {
  Scene scene = Star({{.angle = 0.9, .fixed = true}}, 0.8, 0.2);
  // A second striker comes to the fixed disc from its other side at the same time.
  Body second = scene.bodies[0];
  second.name = "second";
  second.position = 2 * scene.bodies[1].position - scene.bodies[0].position;
  second.velocity = -scene.bodies[0].velocity;
  scene.bodies.push_back(second);
  const EventRun run(scene);
  EXPECT_EQ(run.simulator.touches().size(), 2u);
  EXPECT_TRUE(TiesOf(run.simulator).empty());
  // Were it free, they would.
  scene.bodies[1].fixed = false;
  scene.bodies[1].mass = 0.6;
  EXPECT_EQ(TiesOf(EventRun(scene).simulator).size(), 1u);
}

// Strikers at both ends of a row that touches: no disc is struck twice, the row connects them.
TEST(EventTies, ThroughAChainOfTouchingDiscs) {
  Scene scene = Cradle(4, 1);
  scene.bodies[3].position[0] += 0.5;
  scene.bodies[3].velocity = {-1, 0};
  EXPECT_TRUE(TiesOf(EventRun(scene).simulator).empty());
  scene.bodies[1].mass = 2;
  const std::vector<Tie> ties = TiesOf(EventRun(scene).simulator);
  ASSERT_EQ(ties.size(), 1u);
  EXPECT_EQ(ties[0].bodies, (std::vector<std::string>{"d0", "d1", "d2", "d3"}));
  // A gap in the row: two impacts that know nothing of each other, and later ones one by one.
  scene.bodies[1].position[0] -= 1e-3;
  scene.bodies[0].position[0] -= 1e-3;
  EXPECT_TRUE(TiesOf(EventRun(scene).simulator).empty());
}

// The last bounces of a disc in a groove, and of one disc on another, are of no consequence.
TEST(EventTies, NothingIsSaidOfDiscsThatComeToRest) {
  for (double restitution : {0.0, 0.3, 0.7}) {
    for (double friction : {0.0, 0.4}) {
      Scene scene;
      scene.duration = 3;
      scene.steps = 300;
      scene.gravity = {0, -9.81};
      scene.contact = {.restitution = restitution, .friction = friction};
      scene.bodies = {{.name = "low", .radius = 0.1, .mass = 1, .position = {0.02, 0.5}}};
      for (double angle : {0.5, 0.9, 1.3}) {
        const Vec2d left = Along(angle), right = {-left[0], left[1]};
        scene.planes = {{"left", {0, 0}, left}, {"right", {0, 0}, right}};
        EXPECT_TRUE(TiesOf(EventRun(scene).simulator).empty()) << angle << " " << restitution << " " << friction;
      }
      scene.planes = {{"ground", {0, 0}, {0, 1}}};
      scene.bodies.push_back({.name = "high", .radius = 0.1, .mass = 1, .position = {0.02, 0.8}});
      EXPECT_TRUE(TiesOf(EventRun(scene).simulator).empty()) << restitution << " " << friction;
    }
  }
}

// Two discs at a right angle: either order leads to the same velocities, but not to the same derivatives. The gradient
// is that of the order that is taken, in which the first candidate comes first.
TEST(EventTies, WhereOrdersAgreeTheGradientIsThatOfOneOfThem) {
  const double right = std::numbers::pi / 2;
  const Scene scene = Star({{.angle = 0.9}, {.angle = 0.9 - right}}, 1, 0);
  const auto gradient_with = [&](double first_later, double second_later) {
    Scene moved = scene;
    moved.bodies[1].position += first_later * Along(0.9);
    moved.bodies[2].position += second_later * Along(0.9 - right);
    EventRun run(moved);
    EXPECT_TRUE(TiesOf(run.simulator).empty());
    EXPECT_EQ(run.simulator.touches().size(), 2u);
    return run.GradientOf(2).initial;  // of the striker's final velocity
  };
  const double later = 1e-6;
  const std::vector<double> tied = gradient_with(0, 0), in_order = gradient_with(0, later),
                            backwards = gradient_with(later, 0);
  double kink = 0;
  for (std::size_t i = 0; i < tied.size(); ++i) {
    EXPECT_NEAR(tied[i], in_order[i], 1e-3) << i;
    kink = std::max(kink, std::abs(tied[i] - backwards[i]));
  }
  EXPECT_GT(kink, 0.5);
}

TEST(EventTies, OrdersOfManyContacts) {
  EXPECT_EQ(NumTieOrders(2), 2);
  EXPECT_EQ(NumTieOrders(4), 24);
  EXPECT_EQ(NumTieOrders(5), 24);
  EXPECT_EQ(NumTieOrders(40), 24);
  for (int n : {1, 2, 3, 4, 5, 6, 17}) {
    std::vector<std::vector<int>> all;
    for (int order = 1; order <= NumTieOrders(n); ++order) {
      std::vector<int> contacts(n);
      std::iota(contacts.begin(), contacts.end(), 0);
      ArrangeTie(order, contacts);
      all.push_back(contacts);
      std::sort(contacts.begin(), contacts.end());
      for (int i = 0; i < n; ++i) ASSERT_EQ(contacts[i], i);
    }
    std::sort(all.begin(), all.end());
    if (n <= 4) {
      EXPECT_EQ(std::unique(all.begin(), all.end()), all.end());
    }
  }
}

// Seven discs around one that moves into them.
TEST(EventTies, MoreContactsThanAllOrdersAreTriedOf) {
  std::vector<Target> targets;
  for (int i = 0; i < 7; ++i) targets.push_back({.angle = -1.2 + 0.41 * i, .radius = 0.018});
  const Scene scene = Star(targets, 0.9, 0);
  const std::vector<Tie> ties = TiesOf(EventRun(scene).simulator);
  ASSERT_EQ(ties.size(), 1u);
  EXPECT_EQ(ties[0].bodies.size(), 8u);
  EXPECT_EQ(ties[0].num_contacts, 7);
}

}  // namespace
}  // namespace saltus
