#include "campaign/scenes.h"

#include <cmath>
#include <numbers>

#include "contact/random_scene.h"

namespace saltus::campaign {
namespace {

using testing::RandomScenes;

constexpr double kGravity = 9.8;

void AddDisc(double radius, const Vec2d& position, const Vec2d& velocity, RandomScenes* random, Scene* scene) {
  scene->bodies.push_back({.name = "disc" + std::to_string(scene->num_bodies()),
                           .radius = radius,
                           .mass = random->Chance(0.5) ? 1 : random->Uniform(0.3, 3),
                           .position = position,
                           .velocity = velocity});
}

void AddFixed(double radius, const Vec2d& position, Scene* scene) {
  scene->bodies.push_back(
      {.name = "post" + std::to_string(scene->num_bodies()), .radius = radius, .fixed = true, .position = position});
}

void AddPlane(const Vec2d& point, const Vec2d& normal, Scene* scene) {
  scene->planes.push_back({"plane" + std::to_string(scene->planes.size()), point, normal});
}

// A direction; half of the time one whose arithmetic is exact.
Vec2d AnyDirection(RandomScenes* random) {
  const Vec2d axes[] = {{1, 0}, {0, 1}, {-1, 0}, {0, -1}};
  return random->Chance(0.5) ? axes[random->Integer(0, 3)] : random->Direction();
}

// A small number or zero.
double Sometimes(double probability, double size, RandomScenes* random) {
  return random->Chance(probability) ? random->Uniform(-size, size) : 0;
}

// Discs anywhere, in a box or in the open.
void Gas(RandomScenes* random, Scene* scene) {
  random->AddDiscs(random->Integer(1, 8), 0.3, scene);
  const Vec2d up = AnyDirection(random);
  const Vec2d normals[] = {up, Perpendicular(up), -up, -Perpendicular(up)};
  const int planes = random->Chance(0.6) ? 4 : random->Integer(0, 2);
  for (int i = 0; i < planes; ++i) random->AddPlane(normals[i], scene);
  if (random->Chance(0.5)) scene->gravity = random->InSquare(kGravity);
}

// A row that touches or nearly does, struck from one side or from both.
void Chain(RandomScenes* random, Scene* scene) {
  const int count = random->Chance(0.1) ? random->Integer(5, 6) : random->Integer(2, 4);
  const double radius = random->Chance(0.5) ? 0.125 : random->Uniform(0.08, 0.2);
  const Vec2d along = AnyDirection(random);
  const double gap = random->Chance(0.7) ? 0 : random->Uniform(0, 0.01);
  const double mass = random->Chance(0.7) ? 1 : 0;
  for (int i = 0; i < count; ++i) AddDisc(radius, i * (2 * radius + gap) * along, Vec2d(0, 0), random, scene);
  const Vec2d aside = Sometimes(0.3, 0.5 * radius, random) * Perpendicular(along);
  const double speed = random->Uniform(0.5, 3), distance = random->Uniform(0.25, 0.6);
  AddDisc(radius, -(2 * radius + distance) * along + aside, speed * along, random, scene);
  if (random->Chance(0.3)) {
    const double end = (count - 1) * (2 * radius + gap) + 2 * radius + distance;
    AddDisc(radius, end * along + aside, -speed * along, random, scene);
  }
  for (Body& body : scene->bodies) body.mass = mass > 0 ? mass : body.mass;
  if (random->Chance(0.2)) scene->bodies[count - 1].fixed = true;
}

// One disc strikes two or three at once.
void Tie(RandomScenes* random, Scene* scene) {
  const double radius = random->Chance(0.5) ? 0.125 : random->Uniform(0.08, 0.2);
  const Vec2d along = AnyDirection(random), across = Perpendicular(along);
  const double spread = radius * (random->Chance(0.5) ? 1 : random->Uniform(1, 1.8));
  const double late = Sometimes(0.2, 1e-3, random), speed = random->Uniform(0.5, 3);
  AddDisc(radius, spread * across, Vec2d(0, 0), random, scene);
  AddDisc(radius, -spread * across + late * along, Vec2d(0, 0), random, scene);
  AddDisc(radius, -random->Uniform(0.5, 1) * along, speed * along, random, scene);
  if (random->Chance(0.5)) scene->bodies[1].mass = scene->bodies[0].mass;
  if (random->Chance(0.2)) scene->bodies[random->Integer(0, 1)].fixed = true;
  if (random->Chance(0.3)) AddDisc(radius, (spread + 2 * radius) * across, Vec2d(0, 0), random, scene);
  if (random->Chance(0.3)) random->AddPlane(-along, scene);
}

// Discs on a slope or level: at rest, dropped, or sliding along.
void Ground(bool sliding, RandomScenes* random, Scene* scene) {
  const double slope = Sometimes(0.5, 0.6, random);
  const Vec2d up(std::sin(slope), std::cos(slope)), along = -Perpendicular(up);
  AddPlane({0, 0}, up, scene);
  scene->gravity = {0, -kGravity};
  const int count = random->Integer(1, 4);
  for (int i = 0; i < count; ++i) {
    const double radius = random->Uniform(0.08, 0.15);
    const double height = random->Chance(0.7) ? 0 : random->Uniform(0, 0.5);
    const Vec2d velocity = (sliding ? random->Uniform(-2, 2) : 0) * along + Sometimes(0.2, 1, random) * up;
    const Vec2d position = (i * 0.4 + random->Uniform(-0.04, 0.04)) * along + (radius + height) * up;
    if (i > 0 && random->Chance(0.1)) {
      AddFixed(radius, position, scene);
    } else {
      AddDisc(radius, position, velocity, random, scene);
    }
  }
  if (sliding) scene->contact.friction = random->Uniform(0, 1);
  if (random->Chance(0.3)) AddPlane(2 * along, -along, scene);
}

// A tower or a pyramid on the ground, with or without something that falls on it.
void Stack(RandomScenes* random, Scene* scene) {
  const double radius = 0.125;
  scene->duration *= 0.4;
  AddPlane({0, 0}, {0, 1}, scene);
  scene->gravity = {0, -kGravity};
  if (random->Chance(0.5)) {
    const int count = random->Integer(2, 5);
    for (int i = 0; i < count; ++i) {
      AddDisc(radius, {Sometimes(0.3, 1e-3, random), radius * (2 * i + 1)}, Vec2d(0, 0), random, scene);
    }
  } else {
    const int width = random->Integer(2, 3);
    for (int row = 0; row < width; ++row) {
      for (int i = 0; i + row < width; ++i) {
        const Vec2d position(radius * (2 * i + row), radius * (1 + row * std::numbers::sqrt3));
        AddDisc(radius, position, Vec2d(0, 0), random, scene);
      }
    }
  }
  // Rows may overlap by rounding, or a tower that is off its line by less than nothing: pull them apart a little.
  for (int i = 0; i < scene->num_bodies(); ++i) scene->bodies[i].position[1] *= 1 + (random->Chance(0.2) ? 1e-3 : 0);
  if (random->Chance(0.3)) AddDisc(radius, {random->Uniform(-0.2, 0.2), 1.7}, {0, -1}, random, scene);
  if (random->Chance(0.3)) AddPlane({-radius, 0}, {1, 0}, scene);
  if (random->Chance(0.3)) scene->bodies[0].velocity = {random->Uniform(-2, 2), 0};
}

// Discs thrown into the corner of two planes.
void Corner(RandomScenes* random, Scene* scene) {
  const double half = random->Chance(0.3) ? std::numbers::pi / 4 : random->Uniform(0.35, 1.5);
  const Vec2d axis = AnyDirection(random), side = Perpendicular(axis);
  AddPlane({0, 0}, std::sin(half) * axis + std::cos(half) * side, scene);
  AddPlane({0, 0}, std::sin(half) * axis - std::cos(half) * side, scene);
  if (random->Chance(0.5)) scene->gravity = -kGravity * axis;
  const double radius = random->Uniform(0.08, 0.15);
  const int count = random->Integer(1, 3);
  double along = radius / std::sin(half) + (random->Chance(0.3) ? 0 : random->Uniform(0.01, 0.5));
  for (int i = 0; i < count; ++i) {
    const Vec2d velocity = -random->Uniform(0, 2) * axis + Sometimes(0.5, 1, random) * side;
    AddDisc(radius, along * axis, random->Chance(0.3) ? Vec2d(0, 0) : velocity, random, scene);
    along += 2 * radius + (random->Chance(0.3) ? 0 : random->Uniform(0.01, 0.3));
  }
}

// Discs that fall on posts.
void Posts(RandomScenes* random, Scene* scene) {
  scene->gravity = {0, -kGravity};
  const int posts = random->Integer(1, 4), count = random->Integer(1, 4);
  for (int i = 0; i < posts; ++i) AddFixed(random->Uniform(0.05, 0.3), {0.7 * i, random->Uniform(-0.1, 0.1)}, scene);
  for (int i = 0; i < count; ++i) {
    const Vec2d position(0.7 * random->Integer(0, posts - 1) + Sometimes(0.7, 0.2, random), 0.6 + 0.35 * i);
    AddDisc(random->Uniform(0.08, 0.15), position, {Sometimes(0.3, 1, random), 0}, random, scene);
  }
  if (random->Chance(0.5)) AddPlane({0, -0.5}, {0, 1}, scene);
}

// Discs that forces press against each other.
void Pressed(RandomScenes* random, Scene* scene) {
  const int count = random->Integer(2, 5);
  scene->duration *= 0.4;
  const double radius = random->Uniform(0.08, 0.2);
  const Vec2d along = AnyDirection(random);
  for (int i = 0; i < count; ++i) AddDisc(radius, 2 * radius * i * along, Vec2d(0, 0), random, scene);
  const double spin = Sometimes(0.5, 1, random);
  for (int i = 0; i < count; ++i) scene->bodies[i].velocity = spin * i * Perpendicular(along);
  for (const int i : {0, count - 1}) {
    const Vec2d push = (i == 0 ? 1 : -1) * random->Uniform(0, 4) * along;
    scene->control.bodies.push_back(i);
    scene->control.initial.push_back(push + Sometimes(0.5, 1, random) * Perpendicular(along));
  }
}

// The number of each kind in a hundred scenes. The motion of discs in contact that turn takes many short arcs.
constexpr struct {
  const char* name;
  int share;
  void (*make)(RandomScenes*, Scene*);
} kKinds[] = {{"gas", 20, Gas},
              {"chain", 14, Chain},
              {"tie", 14, Tie},
              {"rest", 14, [](RandomScenes* random, Scene* scene) { Ground(false, random, scene); }},
              {"sliding", 14, [](RandomScenes* random, Scene* scene) { Ground(true, random, scene); }},
              {"corner", 12, Corner},
              {"posts", 4, Posts},
              {"stack", 4, Stack},
              {"pressed", 4, Pressed}};

const auto& AnyKind(RandomScenes* random) {
  int left = random->Integer(0, 99);
  for (const auto& kind : kKinds) {
    left -= kind.share;
    if (left < 0) return kind;
  }
  return kKinds[0];
}

// Rows and piles that are elastic or nearly inelastic meet 10 000 times and more: few of those, or they take all the
// time.
void SetContact(RandomScenes* random, Scene* scene) {
  const double which = random->Uniform(0, 1);
  double* restitution = &scene->contact.restitution;
  *restitution = random->Uniform(0.35, 0.9);
  if (which < 0.1) *restitution = random->Uniform(0, 1);
  if (which < 0.04) *restitution = which < 0.02 ? 0 : 1;
  if (random->Chance(0.6)) scene->contact.friction = random->Chance(0.1) ? 1.5 : random->Uniform(0, 1);
}

void Push(RandomScenes* random, Scene* scene) {
  if (scene->num_controlled() > 0) return;
  for (int i = 0; i < scene->num_bodies(); ++i) {
    if (scene->bodies[i].fixed || !random->Chance(0.3)) continue;
    scene->control.bodies.push_back(i);
    scene->control.initial.push_back(random->InSquare(4));
  }
}

}  // namespace

void MeasureEnd(RandomScenes* random, Scene* scene) {
  using Quantity = TerminalTerm::Quantity;
  for (int i = 0; i < scene->num_bodies(); ++i) {
    if (scene->bodies[i].fixed) continue;
    scene->free.push_back(i);
    for (const Quantity quantity : {Quantity::kPosition, Quantity::kVelocity}) {
      for (const int component : {0, 1}) {
        scene->objective.terminal.push_back(
            {.body = i, .quantity = quantity, .component = component, .weight = random->Uniform(-1, 1)});
      }
    }
  }
  scene->optimize = Optimize::kVelocity;
}

NamedScene RandomScene(std::uint32_t seed) {
  RandomScenes random(seed);
  const auto& kind = AnyKind(&random);
  while (true) {
    Scene scene;
    scene.name = "seed_" + std::to_string(seed);
    scene.duration = random.Uniform(0.1, 0.6);
    scene.steps = random.Integer(20, 40);
    SetContact(&random, &scene);
    kind.make(&random, &scene);
    Push(&random, &scene);
    MeasureEnd(&random, &scene);
    if (!Validate(scene)) return {kind.name, scene};  // else some discs overlap
  }
}

}  // namespace saltus::campaign
