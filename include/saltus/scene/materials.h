// Restitution and friction of each pair of things in a scene with materials (Scene::materials).
//
// A pair that Scene::pairs lists has the numbers listed there. The numbers of any other pair are those of its two
// materials, combined by Scene::combine. A body or wall without a material counts as one of the material "default" with
// the numbers of Scene::contact; two of these have those numbers, and nothing is combined.
#pragma once

#include <string>
#include <utility>
#include <vector>

#include "saltus/scene/scene.h"

namespace saltus {

inline constexpr char kNoMaterial[] = "default";  // the name that bodies and walls without a material have here

// Returns the index of a pair in a list of all pairs, by the numbers of its materials: 0 for none, else 1 + the index
// into Scene::materials. The pair of two things without a material has the index 0.
constexpr int MaterialPairIndex(int a, int b) { return a < b ? b * (b + 1) / 2 + a : a * (a + 1) / 2 + b; }

// Returns the numbers of the materials of a pair, counted as in MaterialPairIndex(), of which it is the inverse; the
// lower number comes first. Precondition: index >= 0.
std::pair<int, int> MaterialsOfPair(int index);

// Returns restitution and friction of all pairs, in the order of MaterialPairIndex(): (M + 1)(M + 2) / 2 entries for M
// materials. Empty in a scene without materials.
std::vector<PairContact> PairContactsOf(const Scene& scene);

// Returns restitution and friction of a contact of two bodies, or of a body and a wall, with these materials: indices
// into Scene::materials, or -1 without a material.
PairContact ContactBetween(const Scene& scene, int material, int other);

// Returns the MaterialPairIndex() of all pairs of a body that moves and another body or a wall, without repetition, in
// rising order; {0} in a scene without materials.
std::vector<int> PairsInUse(const Scene& scene);
// Returns whether a contact that can happen has friction: any of PairsInUse(), or Scene::contact without materials.
bool HasFriction(const Scene& scene);

// Returns the name of a pair in names of parameters, such as "rubber-steel".
std::string NameOfPair(int index, const Scene& scene);

}  // namespace saltus
