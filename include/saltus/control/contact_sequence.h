// Sequences of impacts: the pairs that collide, in order of time, as text and as indices of a scene.
//
//   striker-target,target-ceiling     two impacts: striker and target, then target and ceiling
//   none                              no impact at all
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "saltus/contact/step_input.h"
#include "saltus/scene/scene.h"

namespace saltus {

// Pairs by indices of the scene: two discs a < b, or disc a and plane b.
using ContactSequence = std::vector<Candidate>;

// Reads `text` into `sequence`. A pair is two names of `scene` with a hyphen between them, in any order; at least one
// is that of a disc that is not fixed. A pair that names with hyphens make ambiguous is refused. Returns the error and
// what was expected; empty if there is none.
std::string ParseContactSequence(const Scene& scene, std::string_view text, ContactSequence* sequence);

// Returns the text of a sequence, with the discs of a pair in scene order and planes last.
std::string ContactSequenceToString(const Scene& scene, const ContactSequence& sequence);

// Returns every pair that could collide: discs (a, b) in rising order, then discs with planes; not two fixed ones.
ContactSequence AllPairs(const Scene& scene);

// Returns the name of a part of `scene` besides discs and planes (segments, polygons, arcs, pockets or a table), which
// sequences, closed forms and conditions of optimality do not support; empty if there is none.
std::string NonPlaneGeometry(const Scene& scene);
// Returns the name of the part of a scene, drag or springs or prescribed motions, because of which flights have no
// constant acceleration; empty if there is none.
std::string NonBallisticForces(const Scene& scene);
// Returns what NonPlaneGeometry() or NonBallisticForces() returns, or else names discs that spin, for methods without
// rotation; empty if there is none.
std::string NonBallisticFeatures(const Scene& scene);

}  // namespace saltus
