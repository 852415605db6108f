// Random scenes among walls that end, and on tables.
#include <cmath>
#include <numbers>

#include "campaign/scenes.h"
#include "contact/random_scene.h"

namespace saltus::campaign {
namespace {

using testing::RandomScenes;

constexpr double kGravity = 9.8;

std::string Numbered(const char* name, std::size_t number) { return name + std::to_string(number); }

// Corners around the origin, 1.1 to 1.5 m away: a room whose corners may point inwards.
std::vector<Vec2d> Corners(int count, RandomScenes* random) {
  std::vector<Vec2d> points;
  const double turn = random->Uniform(0, 1);
  for (int k = 0; k < count; ++k) {
    const double angle = turn + 2 * std::numbers::pi * k / count;
    points.push_back(random->Uniform(1.1, 1.5) * Vec2d(std::cos(angle), std::sin(angle)));
  }
  return points;
}

// Discs in a room, among segments, a box and arcs.
void Room(RandomScenes* random, Scene* scene) {
  random->AddDiscs(random->Integer(1, 4), 0.2, scene);
  scene->control = {};
  scene->polygons.push_back({"room", Corners(random->Integer(4, 9), random), EdgePolygon::Solid::kOutside});
  for (int k = random->Integer(0, 3); k > 0; --k) {
    const Vec2d from = random->InSquare(0.9);
    scene->segments.push_back({Numbered("segment", scene->segments.size()), from, from + random->InSquare(0.4)});
  }
  if (random->Chance(0.5)) {
    const double from = random->Uniform(0, 6);
    scene->arcs.push_back(
        {"arc", random->InSquare(0.9), random->Uniform(0.05, 0.5), from, from + random->Uniform(0.5, 6)});
  }
  if (random->Chance(0.5)) {
    const Vec2d at = random->InSquare(0.9);
    scene->polygons.push_back({"box", {at, at + Vec2d(0.2, 0), at + Vec2d(0.1, 0.2)}, EdgePolygon::Solid::kInside});
  }
  scene->duration *= 3;
}

// Discs that fall on a polyline, part of it in line, and slide off its ends.
void Terrain(RandomScenes* random, Scene* scene) {
  scene->gravity = {0, -kGravity};
  Vec2d at(-1, 0), along(0.3, 0);
  for (int k = random->Integer(2, 8); k > 0; --k) {
    if (random->Chance(0.6)) along = Vec2d(random->Uniform(0.1, 0.5), random->Uniform(-0.3, 0.3));
    scene->segments.push_back({Numbered("segment", scene->segments.size()), at, at + along});
    at += along;
  }
  const int count = random->Integer(1, 3);
  for (int i = 0; i < count; ++i) {
    scene->bodies.push_back({.name = Numbered("disc", i),
                             .radius = random->Uniform(0.05, 0.15),
                             .mass = random->Uniform(0.3, 3),
                             .position = {random->Uniform(-1.1, at[0] + 0.1), random->Uniform(0.2, 0.8)},
                             .velocity = {random->Uniform(-1, 1), 0}});
  }
  scene->duration *= 2;
}

// Discs that slide on a table in a room, and stop.
void OnATable(RandomScenes* random, Scene* scene) {
  Room(random, scene);
  scene->table = TableFriction{.friction = random->Uniform(0.05, 0.4)};
  for (Body& body : scene->bodies) {
    if (random->Chance(0.4)) body.velocity.setZero();
  }
}

constexpr struct {
  const char* name;
  void (*make)(RandomScenes*, Scene*);
} kKinds[] = {{"room", Room}, {"terrain", Terrain}, {"table", OnATable}};

}  // namespace

NamedScene RandomEdgeScene(std::uint32_t seed) {
  RandomScenes random(seed);
  const auto& kind = kKinds[seed % std::size(kKinds)];
  while (true) {
    Scene scene;
    scene.name = "seed_" + std::to_string(seed);
    scene.duration = random.Uniform(0.1, 0.6);
    scene.steps = random.Integer(20, 40);
    scene.contact.restitution = random.Uniform(0.35, 0.9);
    if (random.Chance(0.5)) scene.contact.friction = random.Uniform(0, 1);
    kind.make(&random, &scene);
    MeasureEnd(&random, &scene);
    if (!Validate(scene)) return {kind.name, scene};  // else something overlaps
  }
}

}  // namespace saltus::campaign
