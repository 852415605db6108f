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

// Returns the index of a pair in a list of all pairs, by the numbers of its materials: 0 for none, else 1 + the index
// into Scene::materials. The pair of two things without a material has the index 0.
constexpr int MaterialPairIndex(int a, int b) { return a < b ? b * (b + 1) / 2 + a : a * (a + 1) / 2 + b; }

// Returns the numbers of the materials of a pair, the lower one first. Precondition: index >= 0.
std::pair<int, int> MaterialsOfPair(int index);

// Returns restitution and friction by MaterialPairIndex(); empty in a scene without materials.
std::vector<PairContact> PairContactsOf(const Scene& scene);

// Returns restitution and friction of two things with these materials, indices into Scene::materials; -1: none.
PairContact ContactBetween(const Scene& scene, int material, int other);

// Returns the MaterialPairIndex() of all pairs of a body that moves and another body or a wall, in rising order. {0} in
// a scene without materials.
std::vector<int> PairsInUse(const Scene& scene);
// Whether any pair of materials in use has friction.
bool HasFriction(const Scene& scene);

// Returns the name of a pair in names of parameters, such as "rubber-steel".
std::string NameOfPair(int index, const Scene& scene);

}  // namespace saltus
