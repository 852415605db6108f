#include "saltus/scene/materials.h"

#include <algorithm>
#include <set>

namespace saltus {
namespace {

double Combined(Combine combine, double a, double b) {
  switch (combine) {
    case Combine::kMean:
      return 0.5 * (a + b);
    case Combine::kProduct:
      return a * b;
    case Combine::kMin:
      return std::min(a, b);
    case Combine::kMax:
      break;
  }
  return std::max(a, b);
}

}  // namespace

std::pair<int, int> MaterialsOfPair(int index) {
  int second = 0;
  while (MaterialPairIndex(0, second + 1) <= index) ++second;
  return {index - MaterialPairIndex(0, second), second};
}

PairContact ContactBetween(const Scene& scene, int material, int other) {
  const PairContact without{scene.contact.restitution, scene.contact.friction};
  if (scene.materials.empty()) return without;
  const PairContact& a = material < 0 ? without : scene.materials[material].contact;
  const PairContact& b = other < 0 ? without : scene.materials[other].contact;
  // Things without a material are not combined: a scene without materials and one where nothing has one are the same.
  PairContact contact = without;
  if (material >= 0 || other >= 0) {
    contact = {Combined(scene.combine, a.restitution, b.restitution), Combined(scene.combine, a.friction, b.friction)};
  }
  for (const MaterialPair& pair : scene.pairs) {
    if (std::minmax(pair.a, pair.b) != std::minmax(material, other)) continue;
    contact.restitution = pair.restitution.value_or(contact.restitution);
    contact.friction = pair.friction.value_or(contact.friction);
  }
  return contact;
}

std::vector<PairContact> PairContactsOf(const Scene& scene) {
  std::vector<PairContact> contacts;
  if (scene.materials.empty()) return contacts;
  for (int b = -1; b < static_cast<int>(scene.materials.size()); ++b) {
    for (int a = -1; a <= b; ++a) contacts.push_back(ContactBetween(scene, a, b));
  }
  return contacts;
}

std::vector<int> PairsInUse(const Scene& scene) {
  if (scene.materials.empty()) return {0};
  std::vector<int> bodies(scene.materials.size() + 1, 0);  // how many there are of each material
  std::set<int> moving, walls, pairs;                      // numbers of materials
  for (const Body& body : scene.bodies) {
    ++bodies[body.material + 1];
    if (!body.fixed) moving.insert(body.material + 1);
  }
  for (const Plane& plane : scene.planes) walls.insert(plane.material + 1);
  for (const EdgeSegment& segment : scene.segments) walls.insert(segment.material + 1);
  for (const EdgePolygon& polygon : scene.polygons) walls.insert(polygon.material + 1);
  for (const EdgeArc& arc : scene.arcs) walls.insert(arc.material + 1);
  for (const int a : moving) {
    for (const int b : walls) pairs.insert(MaterialPairIndex(a, b));
    for (int b = 0; b < static_cast<int>(bodies.size()); ++b) {
      if (bodies[b] > (a == b ? 1 : 0)) pairs.insert(MaterialPairIndex(a, b));
    }
  }
  return {pairs.begin(), pairs.end()};
}

bool HasFriction(const Scene& scene) {
  if (scene.materials.empty()) return scene.contact.friction > 0;
  const std::vector<PairContact> contacts = PairContactsOf(scene);
  const std::vector<int> pairs = PairsInUse(scene);
  return std::any_of(pairs.begin(), pairs.end(), [&](int pair) { return contacts[pair].friction > 0; });
}

std::string NameOfPair(int index, const Scene& scene) {
  const auto name = [&](int number) { return number == 0 ? kNoMaterial : scene.materials[number - 1].name; };
  const auto [a, b] = MaterialsOfPair(index);
  return name(a) + '-' + name(b);
}

}  // namespace saltus
