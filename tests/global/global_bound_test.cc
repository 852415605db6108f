#include "saltus/global/global_bound.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <memory>
#include <vector>

#include "base/random.h"
#include "campaign/small_problems.h"
#include "global/relaxation.h"
#include "saltus/solve/solver.h"
#include "simulate/flight.h"
#include "test_scenes.h"

namespace saltus {
namespace {

using global::BoxBound;
using global::ImpactBox;
using global::kLargestTau;
using global::Multipliers;
using global::Relaxation;

constexpr double kTwoBalls = 1.396542160123, kSingleCollision = 0.311416870358;  // data/exact_references.json

// The least loss of two_balls at the time s of its impact and the angle psi between normal and line of centres.
double TwoBallsLoss(double s, double psi) {
  const double e = 0.1, c = std::sqrt(2.0) * std::cos(psi), d = c - 0.4;
  const double a = (1 - s) * (1 - s) + 4 * e / s, b = (1 - s) * c + 6 * e * d / (s * s);
  return 2 + e * (12 * d * d + 6 - 3 * c * c) / (s * s * s) - b * b / a;
}

// A box around parameters, with the normal towards the first disc of each pair.
class BoxMaker {
 public:
  void Add(const Candidate& pair, double time, const Vec2d& normal) {
    box.sequence.push_back(pair);
    box.repeated.push_back(false);
    at.push_back(time);
    box.quarters.push_back(0);
    if (pair.plane) return;
    const double angle = std::atan2(normal[1], normal[0]), quarter = std::round(angle / M_PI_2);
    box.quarters.back() = (static_cast<int>(quarter) + 4) % 4;
    at.push_back(std::tan(0.5 * (angle - quarter * M_PI_2)));
  }
  // Returns a box with widths drawn up to `width`, in which the parameters are anywhere.
  ImpactBox Around(double width, Random* random) const {
    ImpactBox out = box;
    for (const double x : at) {
      out.low.push_back(x - width * random->Unit() - 1e-9);
      out.high.push_back(x + width * random->Unit() + 1e-9);
    }
    return out;
  }

  ImpactBox box;
  std::vector<double> at;
};

// Whether the part of a box that a bound keeps has these parameters.
bool Keeps(const BoxBound& bound, const std::vector<double>& at) {
  for (size_t j = 0; j < bound.low.size(); ++j) {
    if (!(bound.low[j] <= at[j] && at[j] <= bound.high[j])) return false;
  }
  return true;
}

TEST(Relaxation, IsTheClosedFormOfOneImpact) {
  const Relaxation relaxation(ProblemScene("two_balls"));
  for (const double s : {0.3, 0.5, 0.68322, 0.9}) {
    for (const double psi : {-1.1, -0.4, 0.0, 0.2, 0.9}) {
      BoxMaker point;
      point.Add({0, 1, false}, s, {std::cos(1.25 * M_PI + psi), std::sin(1.25 * M_PI + psi)});
      ImpactBox box = point.box;
      box.low = box.high = point.at;
      const BoxBound bound = relaxation.Bound(box, 1e3);
      const double exact = TwoBallsLoss(s, psi);
      EXPECT_NEAR(bound.at_middle, exact, 1e-8 * exact) << s << " " << psi;
      EXPECT_NEAR(bound.lower, exact, 1e-7 * exact) << s << " " << psi;
      EXPECT_LE(bound.lower, exact * (1 + 1e-12)) << s << " " << psi;
    }
  }
}

TEST(Relaxation, KeepsEveryBoxWithTheOptimum) {
  const Relaxation relaxation(ProblemScene("two_balls"));
  Random random(1);
  BoxMaker optimum;
  optimum.Add({0, 1, false}, 0.68322, {std::cos(1.25 * M_PI), std::sin(1.25 * M_PI)});
  for (int i = 0; i < 300; ++i) {
    ImpactBox box = optimum.Around(std::pow(10, -4 * random.Unit()), &random);
    for (const bool open : {false, true}) {
      box.open = open;
      const BoxBound bound = relaxation.Bound(box, kTwoBalls * (1 + 1e-9));
      EXPECT_LE(bound.lower, kTwoBalls + 1e-9);
      EXPECT_TRUE(Keeps(bound, optimum.at));
    }
  }
}

TEST(Relaxation, ConvergesWithTheSquareOfTheWidth) {
  const Relaxation relaxation(ProblemScene("two_balls"));
  for (const double width : {0.01, 0.001}) {
    BoxMaker point;
    point.Add({0, 1, false}, 0.6, {-0.8, -0.6});
    ImpactBox box = point.box;
    double least = INFINITY;  // of the closed form on the box
    for (const double x : point.at) {
      box.low.push_back(x - width);
      box.high.push_back(x + width);
    }
    for (int i = -10; i <= 10; ++i) {
      for (int j = -10; j <= 10; ++j) {
        const double tau = point.at[1] + 0.1 * j * width;
        least = std::min(least, TwoBallsLoss(0.6 + 0.1 * i * width, M_PI + 2 * std::atan(tau) - 1.25 * M_PI));
      }
    }
    const double lower = relaxation.Bound(box, 100).lower;
    EXPECT_LE(lower, least);
    EXPECT_GE(lower, least - 1000 * width * width);
  }
}

// The multipliers of a box serve its halves, whose bounds are then no lower.
TEST(Relaxation, HalvesAreBoundedNoLowerThanTheWhole) {
  constexpr double kKnown = 100;
  const Relaxation relaxation(ProblemScene("two_balls"));
  Random random(2);
  int higher = 0;
  for (int i = 0; i < 100; ++i) {
    ImpactBox box;
    box.sequence = {{0, 1, false}};
    box.repeated = {false};
    box.quarters = {random.UniformIndex(4)};
    box.open = i % 2 == 0;
    for (const double range : {0.5, kLargestTau}) box.low.push_back(range * random.Unit());
    for (const double low : box.low) box.high.push_back(low + 0.1 + 0.2 * random.Unit());
    const BoxBound whole = relaxation.Bound(box, kKnown);
    if (whole.lower >= kKnown) continue;
    ASSERT_NE(whole.multipliers, nullptr);
    box.high[whole.split] = 0.5 * (box.low[whole.split] + box.high[whole.split]);
    const BoxBound half = relaxation.Bound(box, kKnown, whole.multipliers.get());
    EXPECT_GE(half.lower, whole.lower - 1e-12 * std::abs(whole.lower));
    higher += half.lower > whole.lower;
    // A loss that those multipliers exclude takes no others.
    if (whole.lower <= 0) continue;
    EXPECT_EQ(relaxation.Bound(box, 0.5 * whole.lower, whole.multipliers.get()).at_middle, 0);
  }
  EXPECT_GT(higher, 30);
}

// A negative multiplier of the approach, which is no condition at the optimum, would raise the dual function above it.
TEST(Relaxation, RejectsMultipliersOfTheWrongSign) {
  constexpr size_t kOfApproach = 4;  // after two of the only term and two of the place
  const Relaxation relaxation(ProblemScene("two_balls"));
  BoxMaker optimum;
  optimum.Add({0, 1, false}, 0.68322, {std::cos(1.25 * M_PI), std::sin(1.25 * M_PI)});
  ImpactBox box = optimum.box;
  box.low = box.high = optimum.at;
  const BoxBound right = relaxation.Bound(box, 100);
  ASSERT_NE(right.multipliers, nullptr);
  ASSERT_EQ(right.multipliers->values[kOfApproach], 0);
  for (const double of_approach : {-1e-3, -1e-2}) {
    Multipliers wrong = *right.multipliers;
    wrong.values[kOfApproach] = of_approach;
    EXPECT_LE(relaxation.Bound(box, 100, &wrong).lower, kTwoBalls + 1e-9);
    wrong.values[kOfApproach] = -of_approach;
    EXPECT_EQ(relaxation.Bound(box, 0.9 * kTwoBalls, &wrong).at_middle, 0);  // these are right, and enough
  }
}

// The target of the disc is behind a wall, and the disc gets no further than the force that pushes the striker could
// push it: |q|^2 + 0.3 |q - (-1, -1)|^2 is least at x = -0.7, which is as far as the wall lets it, and y = -0.3 / 1.3.
TEST(Relaxation, EndsInFrontOfAWall) {
  Scene scene = ProblemScene("two_balls");
  scene.planes.push_back({"wall", {-0.5, 0}, {-1, 0}});
  ImpactBox anything;
  anything.open = true;
  EXPECT_NEAR(Relaxation(scene).Bound(anything, 100).lower, 0.49 + 0.3 * 0.09 + 0.3 / 1.3, 1e-6);
}

// From that side the striker would have to be behind the wall.
TEST(Relaxation, ExcludesImpactsBehindAWall) {
  Scene scene = ProblemScene("two_balls");
  BoxMaker maker;
  maker.Add({0, 1, false}, 0.7, {1, 0});
  ImpactBox box = maker.box;
  box.low = {0.65, -0.1};
  box.high = {0.75, 0.1};
  EXPECT_LT(Relaxation(scene).Bound(box, 100).lower, 20);
  scene.planes.push_back({"wall", {-0.5, 0}, {-1, 0}});
  EXPECT_GT(Relaxation(scene).Bound(box, 100).lower, 100);
}

// A force of length 3 for the time 1 has a mean square of at most 9, with which a mass of 2 gets no further than
// 3 / (2 sqrt(3)); one of components up to 3 gets as far in each direction.
TEST(Relaxation, HoldsTheForceWithinItsBounds) {
  Scene scene = ProblemScene("two_balls");
  scene.bodies[0].mass = 2;
  scene.objective.effort = 1e-3;
  scene.objective.terminal = {{.body = 0, .target = {2, 2}}};
  const ImpactBox flight;
  const double reach = 1.5 / std::sqrt(3.0), way = 4 * std::sqrt(2.0);
  scene.control.max_norm = {3};
  const double by_length = Relaxation(scene).Bound(flight, 100).lower;
  EXPECT_NEAR(by_length, std::pow(way - reach, 2) + 1e-3 * 9, 1e-3);
  EXPECT_LE(by_length, std::pow(way - reach, 2) + 1e-3 * 9);
  scene.control.max = {3};
  EXPECT_NEAR(Relaxation(scene).Bound(flight, 100).lower, by_length, 1e-9);
  scene.control.max_norm = {};
  EXPECT_NEAR(Relaxation(scene).Bound(flight, 100).lower, 2 * std::pow(4 - reach, 2) + 1e-3 * 18, 1e-3);
}

// Forces are far too expensive: discs fly, touch at unknown normals, and share what energy they have. Without walls and
// fixed discs their centre flies on by itself, and only the energy around it is shared; with a wall, this holds along
// it.
TEST(Relaxation, TheCentreOfAllDiscsFliesByItself) {
  Scene scene = ProblemScene("two_balls");
  scene.bodies[1].mass = 2;
  scene.bodies[0].velocity = {1, 0.5};
  scene.bodies[1].velocity = {-0.5, 0.2};
  scene.gravity = {0.3, -1};
  scene.objective.effort = 1e6;
  ImpactBox anything;
  anything.open = true;
  const double mass = 3, energy = 1.25 + 2 * 0.29;  // sum of m |v|^2; the velocity of the centre is (0, 0.3)
  const auto expect_loss = [&](double x, double y, double distance) {
    scene.objective.terminal = {{.body = 1, .target = {-1 + x, -1 + y}}};
    const double lower = Relaxation(scene).Bound(anything, 1e3).lower;
    EXPECT_NEAR(lower, distance * distance, 1e-3);
    EXPECT_LE(lower, distance * distance);
  };
  const double around = std::sqrt((energy - mass * 0.09) * (0.5 - 1 / mass));
  expect_loss(3, 4, std::hypot(3 - 0.15, 4 - 0.3 + 0.5) - around);
  expect_loss(-4, 0, std::hypot(-4 - 0.15, 0 - 0.3 + 0.5) - around);

  scene.planes = {{"ground", {0, -8}, {0, 1}}, {"roof", {0, 8}, {0, -1}}};
  const double fall = 0.5 * std::sqrt(mass);  // of |v|, integrated
  expect_loss(6, 0, 6 - 0.15 - (std::sqrt(energy) + fall) * std::sqrt(0.5 - 1 / mass));

  scene.planes.push_back({"wall", {-20, 0}, {1, 0}});
  const double all = (std::sqrt(energy) + std::hypot(0.3, 1) * fall) * std::sqrt(0.5);
  expect_loss(6, 0, 6 - all);
  scene.planes.clear();
  scene.bodies.push_back({.name = "post", .radius = 0.1, .fixed = true, .position = {-20, 0}});
  expect_loss(6, 0, 6 - all);
}

// Two discs at rest that touch, the first one pushed. It touches the second one at some time, may do so again until it
// touches a wall, and has a target along or across that wall. A disc far away is fixed, so that no momentum is
// conserved.
class RepeatedImpacts {
 public:
  RepeatedImpacts(const Vec2d& target, double to_wall, double restitution_of_wall) : scene_(ProblemScene("two_balls")) {
    scene_.bodies[0].position = {0, 0};
    scene_.bodies[1].position = {0.4, 0};
    scene_.bodies.push_back({.name = "post", .radius = 0.1, .fixed = true, .position = {20, 0}});
    scene_.planes = {{"wall", {0, -0.2 - to_wall}, {0, 1}}};
    scene_.materials = {{"soft", {.restitution = restitution_of_wall}}};
    scene_.planes[0].material = 0;
    scene_.combine = Combine::kProduct;
    scene_.objective.terminal = {{.body = 0, .target = target}};
  }
  const Scene& scene() const { return scene_; }
  void AlsoAim(const Vec2d& target) { scene_.objective.terminal.push_back({.body = 1, .target = target}); }

  double Bound(double first, double at_wall, bool repeated) const {
    BoxMaker maker;
    maker.Add({0, 1, false}, first, {-1, 0});
    maker.Add({0, 0, true}, at_wall, {});
    ImpactBox box = maker.box;
    box.low = box.high = maker.at;
    box.open = true;
    box.repeated[0] = repeated;
    return Relaxation(scene_).Bound(box, 1e3).lower;
  }

 private:
  Scene scene_;
};

// The dual function of the target's multiplier a is a D - a^2 K, with D the distance. In 4 e m^2 K - e m^2 / w are the
// forces after the wall with r^3 / 3, and those of the time h before, whose effort is shared out: to what they do to
// the position, h^3 / 3; to repeated impacts, which change the velocity by c times a third of that; and all of it to
// the velocity at the wall, r^2 h. Parts p of an effort have the least sum of q / p at (sum of roots of q)^2.
TEST(Relaxation, RepeatedImpactsShareTheWholeEffort) {
  const RepeatedImpacts impacts({-3, 0}, 0, 1);
  const double e = impacts.scene().objective.effort, c = 1;  // (1 + restitution) / 2
  for (const double h : {0.3, 0.6, 0.9}) {
    const double r = 1 - h, position = std::sqrt(h * h * h / 3) * (1 + c / std::sqrt(3.0));
    const double k = 0.25 + (r * r * r / 3 + std::pow(position + r * std::sqrt(h), 2)) / (4 * e);
    const double exact = 9 / (4 * k), lower = impacts.Bound(0, h, true);
    EXPECT_NEAR(lower, exact, 2e-3 * exact) << h;
    EXPECT_LE(lower, exact * (1 + 1e-9)) << h;
  }
}

// The second disc has a target at the same distance. Repeated impacts push the two apart, so that they count by the
// difference of the costates only. The dual function of both multipliers is maximised by a search in eight directions.
TEST(Relaxation, RepeatedImpactsAreOpposite) {
  RepeatedImpacts impacts({-3, 0}, 0, 1);
  impacts.AlsoAim({-2.6, 0});
  const double e = impacts.scene().objective.effort, h = 0.6, r = 1 - h;
  const auto dual = [&](double a, double b) {
    const double root = std::sqrt(h * h * h / 3);
    const double before = root * (std::abs(a) + std::abs(a - b) / std::sqrt(3.0)) + r * std::sqrt(h) * std::hypot(a, b);
    return 3 * (a + b) - 0.25 * (a * a + b * b) - (r * r * r / 3 * (a * a + b * b) + before * before) / (4 * e);
  };
  double a = 0, b = 0;
  for (double step = 1; step > 1e-9; step *= 0.5) {
    for (int k = 0; k < 200; ++k) {
      const double x = step * (k % 3 - 1), y = step * (k / 3 % 3 - 1);
      if (dual(a + x, b + y) > dual(a, b)) a += x, b += y;
    }
  }
  const double exact = dual(a, b), lower = impacts.Bound(0, h, true);
  EXPECT_NEAR(lower, exact, 5e-3 * exact);
  EXPECT_LE(lower, exact * (1 + 1e-9));
}

// A wall takes energy from the motion towards it. Repeated impacts may turn that motion along the wall before.
TEST(Relaxation, RepeatedImpactsTurnTheVelocityAnywhere) {
  for (const Vec2d& target : {Vec2d(-2, 2), Vec2d(0, 3)}) {
    const RepeatedImpacts hard(target, 0.3, 1), soft(target, 0.3, 0.2);
    const double exact = hard.Bound(0.4, 0.6, true);
    EXPECT_NEAR(soft.Bound(0.4, 0.6, true), exact, 1e-6 * exact);
    EXPECT_GT(soft.Bound(0.4, 0.6, false), 1.01 * hard.Bound(0.4, 0.6, false));
  }
}

TEST(GlobalBound, TwoBalls) {
  const GlobalBound bound = BoundGlobally(ProblemScene("two_balls"), kTwoBalls + 1e-9, {.gap = 1e-6, .boxes = 100000});
  EXPECT_FALSE(bound.interrupted);
  EXPECT_GE(bound.lower, kTwoBalls - 1e-6);
  EXPECT_LE(bound.lower, kTwoBalls + 1e-9);
  ASSERT_FALSE(bound.left.empty());
  EXPECT_EQ(bound.left.front().sequence, (ContactSequence{{0, 1, false}}));
  EXPECT_FALSE(bound.excluded.empty());
}

// Nothing that has the optimum is excluded, though all that is known is worse.
TEST(GlobalBound, IsBelowTheOptimumWhateverIsKnown) {
  const std::pair<const char*, double> optima[] = {{"two_balls", kTwoBalls}, {"single_collision", kSingleCollision}};
  for (const auto& [name, optimum] : optima) {
    const GlobalBound bound = BoundGlobally(ProblemScene(name), 1.1 * optimum, {.gap = 1e-6, .boxes = 12000});
    EXPECT_TRUE(bound.interrupted) << name;
    EXPECT_LE(bound.lower, optimum + 1e-11) << name;  // optima are known to 12 digits
    EXPECT_GE(bound.lower, 0.2 * optimum) << name;
  }
}

// Boxes whose bounds are within the gap are not divided further. They are left, and the bound is below theirs.
TEST(GlobalBound, LeavesWhatIsWithinTheGap) {
  const Scene scene = ProblemScene("two_balls");
  std::size_t boxes = 0;
  for (const double gap : {1e-6, 1e-3, 0.03, 0.1}) {
    for (const double known : {kTwoBalls + 1e-9, kTwoBalls + 0.5 * gap, kTwoBalls + 0.99 * gap}) {
      const GlobalBound bound = BoundGlobally(scene, known, {.gap = gap, .boxes = 20000});
      EXPECT_FALSE(bound.interrupted);
      EXPECT_LE(bound.gap(), gap);
      EXPECT_LE(bound.lower, kTwoBalls + 1e-11);
      ASSERT_FALSE(bound.left.empty());
      EXPECT_LE(bound.left.front().lower, kTwoBalls + 1e-11);
      EXPECT_GE(bound.left.front().lower, bound.lower);
      if (known == kTwoBalls + 1e-9) {
        EXPECT_TRUE(boxes == 0 || bound.boxes < boxes);
        boxes = bound.boxes;
      }
    }
  }
}

TEST(GlobalBound, NeverFallsAndEndsAtItsLimits) {
  std::vector<double> lowers;
  GlobalOptions options{.gap = 1e-6, .boxes = 2000};
  options.progress = [&](const GlobalBound& bound) { lowers.push_back(bound.lower); };
  const Scene scene = ProblemScene("single_collision");
  const GlobalBound limited = BoundGlobally(scene, kSingleCollision, options);
  EXPECT_TRUE(limited.interrupted);
  EXPECT_TRUE(std::is_sorted(lowers.begin(), lowers.end()));
  EXPECT_GT(lowers.size(), 5u);
  EXPECT_LT(limited.lower, kSingleCollision);
  ASSERT_FALSE(limited.left.empty());
  EXPECT_GE(limited.left.front().lower, limited.lower);

  options.stop = [] { return true; };
  const GlobalBound stopped = BoundGlobally(scene, kSingleCollision, options);
  EXPECT_TRUE(stopped.interrupted);
  EXPECT_LT(stopped.boxes, limited.boxes);
}

// ------------------------------------------------------------------------------------------- against real motions

// True if no disc of the pair is in another impact since its last one.
bool IsRepetition(const Scene& scene, const ContactSequence& sequence, const Candidate& pair, size_t* last) {
  for (size_t i = sequence.size(); i-- > 0;) {
    const Candidate& other = sequence[i];
    *last = i;
    if (other == pair) return true;
    const auto has = [&](int body) {
      return !scene.bodies[body].fixed && (other.a == body || (!other.plane && other.b == body));
    };
    if (has(pair.a) || (!pair.plane && has(pair.b))) return false;
  }
  return false;
}

// Which repetitions of an impact are left to that one: none, all, or all but the last.
enum class Merged { kNone, kAll, kAllButLast };

struct MotionBox {
  ImpactBox box;
  std::vector<double> at;  // the parameters of the motion
};

// The boxes around the first impacts that decide about the loss, one more each, and in the end closed.
std::vector<MotionBox> BoxesOf(const Scene& scene, const Flight& flight, double width, Merged merged, Random* random) {
  std::vector<bool> relevant(scene.num_bodies(), false);
  for (const TerminalTerm& term : scene.objective.terminal) relevant[term.body] = true;
  std::vector<const Flight::Hit*> hits;
  for (size_t i = flight.hits().size(); i-- > 0;) {
    const Flight::Hit& hit = flight.hits()[i];
    const Candidate& pair = hit.contact;
    if (!relevant[pair.a] && (pair.plane || !relevant[pair.b])) continue;
    relevant[pair.a] = true;
    if (!pair.plane) relevant[pair.b] = true;
    hits.insert(hits.begin(), &hit);
  }
  BoxMaker maker;
  std::vector<MotionBox> boxes;
  ContactSequence contacts;
  for (const Flight::Hit* hit : hits) contacts.push_back(hit->contact);
  for (size_t i = 0; i < hits.size(); ++i) {
    const Flight::Hit* hit = hits[i];
    if (maker.at.size() + 2 > static_cast<size_t>(global::kMostParameters)) return boxes;
    const Candidate& pair = hit->contact;
    size_t last = 0;
    const auto next = std::find(contacts.begin() + i + 1, contacts.end(), pair);
    size_t at = 0;
    const bool is_last = next == contacts.end() || !IsRepetition(scene, {contacts.begin(), next}, pair, &at);
    if (merged != Merged::kNone && !(merged == Merged::kAllButLast && is_last) &&
        IsRepetition(scene, maker.box.sequence, pair, &last)) {
      maker.box.repeated[last] = true;
      continue;
    }
    const Vec2d between = pair.plane ? Vec2d::Zero() : Vec2d(hit->before.p[pair.a] - hit->before.p[pair.b]);
    maker.Add(pair, hit->time, between);
    ImpactBox box = maker.Around(width, random);
    box.open = true;
    boxes.push_back({box, maker.at});
    if (!pair.plane) {
      box.free_normal = true;
      box.low.pop_back();
      box.high.pop_back();
      boxes.push_back({box, maker.at});
    }
  }
  boxes.push_back({maker.Around(width, random), maker.at});
  return boxes;
}

TEST(Relaxation, IsBelowTheLossOfEveryMotion) {
  constexpr int kScenes = 300, kControls = 6;
  Random random(7);
  int checked = 0, with_impacts = 0, tight = 0, narrowed = 0, cut_off = 0;
  std::ptrdiff_t repeated = 0;
  for (int number = 0; number < kScenes; ++number) {
    const Scene scene = SmallProblem(&random);
    if (Validate(scene)) continue;
    ASSERT_EQ(UnsupportedByGlobalBound(scene), "");
    const Relaxation relaxation(scene);
    for (int k = 0; k < kControls; ++k) {
      const double strength = 10 * random.Unit();
      std::vector<double> control(scene.steps * scene.control_width());
      const Vec2d mean(strength * random.Symmetric() + 3, strength * random.Symmetric());
      for (size_t i = 0; i < control.size(); ++i) control[i] = mean[i % 2] + 0.3 * strength * random.Symmetric();
      if (k == 0 && number % 5 == 0) {  // a good one, near which bounds are tight
        Scene pushed = scene;
        for (Vec2d& force : pushed.control.initial) force = mean;
        const SolveReport report = Solve("ceres_lm", {pushed, "event"}, {.limits = {.iterations = 30}});
        if (!report.solution.control.empty()) control = report.solution.control;
      }
      const std::vector<double> durations(scene.steps, scene.dt());
      const std::vector<double> initial = InitialState(scene);
      const ExactRun run = SimulateUpTo(20, scene, initial, control, durations);
      if (!run.ok || !run.only_impacts || !run.ambiguous.empty()) continue;
      const Flight flight(scene, initial, control, durations, run);
      const double width = k % 3 == 0 ? 0 : std::pow(10, -3 * random.Unit());
      // The bound of the loss of those forces that are no larger than these.
      Scene bounded = scene;
      double largest = 1e-3;
      for (const double force : control) largest = std::max(largest, std::abs(force));
      (k % 2 == 0 ? bounded.control.max : bounded.control.max_norm)
          .assign(scene.control.bodies.size(), k % 2 == 0 ? largest : std::sqrt(2.0) * largest);
      const Relaxation relaxation_of_bounded(bounded);
      std::vector<MotionBox> boxes;
      for (const Merged merged : {Merged::kNone, Merged::kAll, Merged::kAllButLast}) {
        const std::vector<MotionBox> some = BoxesOf(scene, flight, width, merged, &random);
        boxes.insert(boxes.end(), some.begin(), some.end());
      }
      for (const auto& [box, at] : boxes) {
        const Relaxation& used = checked / 2 % 3 == 0 ? relaxation_of_bounded : relaxation;
        std::shared_ptr<const Multipliers> known;
        for (const double upper : {1.001 * run.loss, 0.3 * run.loss}) {
          const BoxBound bound = used.Bound(box, upper, known.get());
          known = bound.multipliers;
          EXPECT_LE(bound.lower, run.loss * (1 + 1e-9))
              << "scene " << number << ", control " << k << ", width " << width << ", " << box.sequence.size()
              << " impacts, open " << box.open << ", free " << box.free_normal;
          EXPECT_TRUE(upper < run.loss || Keeps(bound, at)) << "scene " << number << ", control " << k;
          if (!Keeps(bound, at)) {
            EXPECT_LE(bound.lower_outside, run.loss * (1 + 1e-9)) << "scene " << number << ", control " << k;
            ++cut_off;
          }
          for (size_t j = 0; upper > run.loss && j < bound.low.size(); ++j) {
            if (bound.high[j] - bound.low[j] < 0.999 * (box.high[j] - box.low[j])) ++narrowed;
          }
          ++checked;
          if (!box.sequence.empty()) ++with_impacts;
          repeated += std::count(box.repeated.begin(), box.repeated.end(), true);
          if (bound.lower > 0.3 * run.loss) ++tight;
        }
      }
    }
  }
  EXPECT_GT(checked, 2000);
  EXPECT_GT(with_impacts, 1000);
  EXPECT_GT(tight, 200);
  EXPECT_GT(repeated, 100);
  EXPECT_GT(narrowed, 300);
  EXPECT_GT(cut_off, 20);
}

TEST(GlobalBound, RefusesWhatItDoesNotSupport) {
  Scene scene = ProblemScene("two_balls");
  EXPECT_EQ(UnsupportedByGlobalBound(scene), "");
  scene.contact.friction = 0.1;
  EXPECT_NE(UnsupportedByGlobalBound(scene).find("friction"), std::string::npos);
  scene.contact.friction = 0;
  scene.objective.effort = 0;
  EXPECT_NE(UnsupportedByGlobalBound(scene).find("effort"), std::string::npos);
  scene.objective.effort = 0.1;
  scene.objective.terminal[0].component = 0;
  EXPECT_NE(UnsupportedByGlobalBound(scene).find("linear"), std::string::npos);
  scene = ProblemScene("two_balls");
  scene.optimize = Optimize::kNone;
  EXPECT_NE(UnsupportedByGlobalBound(scene).find("control"), std::string::npos);
  scene = ProblemScene("two_balls");
  scene.bodies[0].inertia.kind = Inertia::Kind::kSolid;
  EXPECT_NE(UnsupportedByGlobalBound(scene).find("spin"), std::string::npos);
}

}  // namespace
}  // namespace saltus
