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

using ContactSequence = std::vector<Candidate>;

// Reads `text` into `sequence`. A pair is two names of `scene` with a hyphen between them, in any order; at least one a
// disc that is not fixed. Names with hyphens may leave two readings: that is refused. Returns what is wrong, and what
// was expected; empty if nothing is.
std::string ParseContactSequence(const Scene& scene, std::string_view text, ContactSequence* sequence);

// Returns the text of a sequence, with the discs of a pair in scene order and planes last.
std::string ContactSequenceToString(const Scene& scene, const ContactSequence& sequence);

// Returns every pair that could collide: discs by index pairs, then discs with planes.
ContactSequence AllPairs(const Scene& scene);

// Returns the name of a part of `scene` beyond discs and planes, which alone sequences, closed forms and conditions of
// optimality support; empty if there is none.
std::string BeyondPlanes(const Scene& scene);
// Returns the name of what makes flights of a scene other than those of constant acceleration, drag or springs or
// prescribed motions; empty if there is nothing.
std::string BeyondBallistic(const Scene& scene);
// Returns the name of either, or of discs that spin, for methods without rotation; empty if there is none.
std::string BeyondPlainDiscs(const Scene& scene);

}  // namespace saltus
