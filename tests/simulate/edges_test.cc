// Segments, polygons and arcs: where their parts count, which of them discs may meet in a step, and every contact model
// on them, against planes and fixed discs.
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <numbers>
#include <random>

#include "saltus/control/contact_sequence.h"
#include "saltus/scene/walls.h"
#include "saltus/simulate/registry.h"
#include "simulate/broad_phase.h"

namespace saltus {
namespace {

Scene Empty() {
  Scene scene;
  scene.name = "edges";
  scene.duration = 0.6;
  scene.steps = 240;
  scene.optimize = Optimize::kNone;
  return scene;
}

// A chain of straight edges, some in line, some turning sharply; a polygon, two arcs.
Scene ManyEdges(std::uint32_t seed) {
  std::mt19937 engine(seed);
  std::uniform_real_distribution<double> uniform(-1, 1);
  Scene scene = Empty();
  Vec2d at(-2, 0), along(0.25, 0);
  for (int k = 0; k < 12; ++k) {
    if (k % 3 != 0) along = Vec2d(0.3 + 0.1 * uniform(engine), 0.5 * uniform(engine));
    scene.segments.push_back({"s" + std::to_string(k), at, at + along});
    at += along;
  }
  scene.polygons = {{"box", {{-1, -2}, {0.5, -2.2}, {0.2, -1.2}, {-0.2, -1.7}}, EdgePolygon::Solid::kInside}};
  scene.arcs = {{"short", {1.5, -1.5}, 0.6, 0.3, 2.2}, {"long", {-1.6, 1.8}, 0.5, -1, 4}};
  return scene;
}

// The least distance of x to points all along the edges, m.
double DistanceToPoints(const Scene& scene, const Vec2d& x) {
  double least = std::numeric_limits<double>::infinity();
  constexpr int kPoints = 2000;
  const auto line = [&](const Vec2d& a, const Vec2d& b) {
    for (int k = 0; k <= kPoints; ++k) least = std::min(least, (a + k / double(kPoints) * (b - a) - x).norm());
  };
  for (const EdgeSegment& segment : scene.segments) line(segment.from, segment.to);
  for (const EdgePolygon& polygon : scene.polygons) {
    for (std::size_t k = 0; k < polygon.points.size(); ++k) {
      line(polygon.points[k], polygon.points[(k + 1) % polygon.points.size()]);
    }
  }
  for (const EdgeArc& arc : scene.arcs) {
    for (int k = 0; k <= kPoints; ++k) {
      const double angle = arc.from + k / double(kPoints) * (arc.to - arc.from);
      least = std::min(least, (arc.center + arc.radius * Vec2d(std::cos(angle), std::sin(angle)) - x).norm());
    }
  }
  return least;
}

TEST(WallParts, ThePartThatIsNearestCounts) {
  std::mt19937 engine(3);
  std::uniform_real_distribution<double> uniform(-2.5, 2.5);
  const Scene scene = ManyEdges(1);
  const std::vector<WallPart> parts = WallPartsOf(scene);
  for (int trial = 0; trial < 300; ++trial) {
    const Vec2d x(uniform(engine), uniform(engine));
    double least = std::numeric_limits<double>::infinity();
    for (const WallPart& part : parts) {
      const double distance = Separate<double>(x, part.wall).distance;
      if (!part.extent.Covers(x)) continue;
      if (distance >= 0) {
        EXPECT_NEAR(part.LeastDistance(x), distance, 1e-14) << part.name;
      }
      least = std::min(least, part.LeastDistance(x));
    }
    // The points are up to 1.3 mm apart.
    const double at_points = DistanceToPoints(scene, x);
    EXPECT_LE(least, at_points + 1e-14) << x.transpose();
    EXPECT_LE(at_points * at_points - least * least, 1e-5) << x.transpose();
  }
}

// Over a joint of edges in line, exactly and as near as numbers go, one part counts.
TEST(WallParts, OnePartCountsOverAJoint) {
  Scene scene = Empty();
  const Vec2d along(0.6, 0.8), normal(-0.8, 0.6);
  const Vec2d joint = 0.1 * along;
  scene.segments = {{"a", -along, joint}, {"b", joint, along}};
  const std::vector<WallPart> parts = WallPartsOf(scene);
  EXPECT_EQ(parts.size(), 7u);  // two sides each, and three ends
  for (const double x : {-1e-9, -1e-16, 0.0, 1e-17, 1e-16, 3e-16, 1e-9}) {
    for (const int side : {-1, 1}) {
      const Vec2d at = joint + x * along + side * 0.3 * normal;
      int count = 0;
      for (const WallPart& part : parts) {
        count += part.extent.Covers(at) && Separate<double>(at, part.wall).distance >= 0;
      }
      EXPECT_GE(count, 1) << x;
      EXPECT_LE(count, std::abs(x) < 1e-15 ? 2 : 1) << x;  // the two directions are rounded differently
    }
  }
}

TEST(WallParts, HaveNames) {
  Scene scene = Empty();
  scene.planes = {{"ground", {0, -1}, {0, 1}}};
  scene.table = TableFriction{.friction = 0.1};
  scene.segments = {{"s", {0, 0}, {1, 0}}, {"t", {1, 0}, {1, 1}}};
  scene.arcs = {{"ring", {5, 5}, 1, 0, 2 * std::numbers::pi}};
  EXPECT_EQ(WallNamesOf(scene),
            (std::vector<std::string>{"ground", "table", "s", "s", "t", "t", "ring", "ring", "s.a", "s.b", "t.b"}));
  EXPECT_NE(NonPlaneGeometry(scene), "");
  scene.segments.clear();
  scene.arcs.clear();
  EXPECT_NE(NonPlaneGeometry(scene), "");
  scene.table.reset();
  EXPECT_EQ(NonPlaneGeometry(scene), "");
}

// Discs that move among edges: the grid never misses what comparing all finds.
TEST(BroadPhaseOfEdges, NearPairsAreAllPairs) {
  for (const bool all_parts : {false, true}) {
    std::mt19937 engine(5);
    std::uniform_real_distribution<double> uniform(-1, 1);
    const std::vector<WallPart> parts = WallPartsOf(ManyEdges(2));
    constexpr int kDiscs = 20;
    std::vector<BroadPhase::Disc> discs;
    std::vector<double> x;
    for (int i = 0; i < kDiscs; ++i) {
      discs.push_back({0.05 + 0.05 * std::abs(uniform(engine)), 1, false});
      x.insert(x.end(), {2 * uniform(engine), 2 * uniform(engine), 3 * uniform(engine), 3 * uniform(engine)});
    }
    BroadPhase::Options options{
        .dt = 2e-3, .chains = all_parts, .push_gap = 0.01, .rounding = 1e-16, .all_parts = all_parts};
    BroadPhase near(parts, discs, options);
    options.all_pairs = 1000;
    BroadPhase all(parts, discs, options);
    for (BroadPhase* phase : {&near, &all}) phase->SetAccelerations(std::vector<double>(kDiscs, 2.0));
    std::size_t found = 0;
    for (int k = 0; k < 400; ++k) {
      std::vector<Candidate> a, b;
      near.Find(x.data(), 4, &a);
      all.Find(x.data(), 4, &b);
      ASSERT_EQ(a, b) << "step " << k;
      for (const Candidate& c : b) found += c.plane;
      for (int i = 0; i < kDiscs; ++i) {
        for (int j = 0; j < 2; ++j) {
          x[4 * i + 2 + j] += 2 * uniform(engine) * options.dt;
          if (std::abs(x[4 * i + j]) > 2) x[4 * i + 2 + j] = -std::copysign(x[4 * i + 2 + j], x[4 * i + j]);
          x[4 * i + j] += options.dt * x[4 * i + 2 + j];
        }
      }
    }
    EXPECT_GT(found, 500u);
  }
}

// A disc on its way to the end of a segment: the steps that are called quiet are.
TEST(BroadPhaseOfEdges, QuietStepsEndShortOfTheContact) {
  Scene scene = Empty();
  scene.segments = {{"s", {1, -1}, {1, 0}}};
  const double dt = 1e-3, v = 0.7;
  BroadPhase phase(WallPartsOf(scene), {{0.1, 1, false}}, {.dt = dt, .chains = false, .push_gap = 0, .rounding = 0});
  phase.SetAccelerations(std::vector<double>{0});
  std::vector<Candidate> candidates;
  const std::vector<double> x = {0, 0.06, v, 0};
  const int quiet = phase.Find(x.data(), 4, &candidates);
  ASSERT_TRUE(candidates.empty());
  const double contact = (1 - 0.08) / v;
  EXPECT_LE(quiet * dt, contact);
  EXPECT_GE(quiet * dt, 0.9 * contact);
}

// The final state of a scene of one moving disc, and its derivatives by the initial one, by rows.
std::vector<double> MotionOf(const std::string& model, const Scene& scene) {
  const auto simulator = MakeSimulator(model, scene, Precision::kDouble);
  EXPECT_TRUE(simulator->Rollout(InitialState(scene), {})) << simulator->FailureReason();
  std::vector<double> state(simulator->state_size());
  simulator->GetState(simulator->num_steps(), state);
  std::vector<double> all(state.begin(), state.begin() + 4);
  for (int row = 0; row < 4; ++row) {
    std::vector<double> cotangent(simulator->state_size(), 0.0), initial(4 * scene.num_bodies());
    cotangent[row] = 1;
    simulator->AdjointInto(cotangent, {.initial = initial, .control = {}});
    all.insert(all.end(), initial.begin(), initial.begin() + 4);
  }
  return all;
}

void ExpectSameMotion(const std::vector<double>& found, const std::vector<double>& expected, double tolerance) {
  double size = 0;
  for (double number : expected) size = std::max(size, std::abs(number));
  for (std::size_t i = 0; i < found.size(); ++i) EXPECT_NEAR(found[i], expected[i], tolerance * size) << "number " << i;
}

class EveryModelOnEdges : public ::testing::TestWithParam<std::string> {
 protected:
  bool Takes(const Scene& scene) const { return ReasonNotApplicable(GetParam(), scene).empty(); }
};

// Whether a disc falls on a plane or on a segment, or the side of a polygon, in its place.
TEST_P(EveryModelOnEdges, ASideIsAPlane) {
  for (const double friction : {0.0, 0.2}) {
    Scene plane = Empty();
    plane.gravity = {0, -9.81};
    plane.bodies = {{.name = "ball", .radius = 0.1, .position = {-0.31, 0.4}, .velocity = {0.7, 0.3}}};
    plane.planes = {{"floor", {0, 0}, {0, 1}}};
    plane.contact = {.restitution = 0.6, .friction = friction, .stiffness = 1e4};
    Scene segment = plane, polygon = plane;
    segment.planes.clear();
    segment.segments = {{"floor", {-2, 0}, {2, 0}}};
    polygon.planes.clear();
    polygon.polygons = {{"block", {{-2, 0}, {0, -1}, {2, 0}}, EdgePolygon::Solid::kInside}};
    if (!Takes(plane) || !Takes(segment)) continue;
    const std::vector<double> expected = MotionOf(GetParam(), plane);
    ExpectSameMotion(MotionOf(GetParam(), segment), expected, 1e-9);
    ExpectSameMotion(MotionOf(GetParam(), polygon), expected, 1e-9);
  }
}

// Whether a disc falls on the end of a segment, or on a fixed disc of no size. (Sources differ by a millionth in how
// they normalise directions. Those that spin may grip discs without friction, and do not grip walls.)
TEST_P(EveryModelOnEdges, AnEndIsASmallDisc) {
  Scene disc = Empty();
  disc.gravity = {0, -9.81};
  disc.bodies = {{.name = "ball", .radius = 0.1, .position = {0.04, 0.4}, .velocity = {0.01, 0.3}},
                 {.name = "tip", .radius = 1e-12, .fixed = true}};
  disc.contact = {.restitution = 1, .friction = 0, .stiffness = 1e4};
  Scene end = disc;
  end.bodies.pop_back();
  end.segments = {{"shelf", {-2, 0}, {0, 0}}};
  if (FindContactModel(GetParam())->spins) GTEST_SKIP() << "discs grip each other otherwise than walls";
  if (!Takes(disc) || !Takes(end)) GTEST_SKIP() << ReasonNotApplicable(GetParam(), end);
  ExpectSameMotion(MotionOf(GetParam(), end), MotionOf(GetParam(), disc), 1e-4);
}

// A model that cannot simulate a table is not applicable, with the reason.
TEST_P(EveryModelOnEdges, OnlyExactEventsTakeATable) {
  Scene scene = Empty();
  scene.bodies = {{.name = "puck", .radius = 0.1, .velocity = {1, 0}}};
  EXPECT_TRUE(Takes(scene));
  scene.table = TableFriction{.friction = 0.1};
  EXPECT_EQ(Takes(scene), FindContactModel(GetParam())->event_driven);
}

std::vector<std::string> Names() {
  std::vector<std::string> names;
  for (const ModelTraits& traits : AllContactModels()) names.emplace_back(traits.name);
  return names;
}

INSTANTIATE_TEST_SUITE_P(AllModels, EveryModelOnEdges, ::testing::ValuesIn(Names()),
                         [](const auto& test) { return test.param; });

}  // namespace
}  // namespace saltus
