// Restitution and friction of each pair of things in a scene with materials (Scene::materials).
//
// A pair that Scene::pairs gives has the numbers given there; any other those of its two materials, combined as
// Scene::combine says. What has no material has the numbers of Scene::contact, and the name "default".
#pragma once

#include <string>
#include <utility>
#include <vector>

#include "saltus/scene/scene.h"

namespace saltus {

inline constexpr char kNoMaterial[] = "default";  // the name of what has no material

// The place of a pair in a list of all pairs, by the numbers of its materials: 0 for none, else 1 + the index into
// Scene::materials. That of two things without a material is 0.
constexpr int MaterialPairIndex(int a, int b) { return a < b ? b * (b + 1) / 2 + a : a * (a + 1) / 2 + b; }

// The numbers of the materials of a pair, the lower one first. Precondition: index >= 0.
std::pair<int, int> MaterialsOfPair(int index);

// Restitution and friction by MaterialPairIndex(); none in a scene without materials.
std::vector<PairContact> PairContactsOf(const Scene& scene);

// Restitution and friction of two things with these materials, indices into Scene::materials; -1: none.
PairContact ContactBetween(const Scene& scene, int material, int other);

// The pairs of materials of things that may touch, by MaterialPairIndex(), rising: of a body that moves and another
// body or a wall. {0} in a scene without materials.
std::vector<int> PairsInUse(const Scene& scene);
// Whether one of these has friction.
bool HasFriction(const Scene& scene);

// The pair as parameters name it, "rubber-steel".
std::string NameOfPair(int index, const Scene& scene);

}  // namespace saltus
