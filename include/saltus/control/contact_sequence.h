// Which pairs collide, in order of time: as written by people, and as indices of a scene.
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

// The text that stands for it, discs in scene order and planes last.
std::string ContactSequenceToString(const Scene& scene, const ContactSequence& sequence);

// Every pair that could collide: discs by index pairs, then discs against planes.
ContactSequence AllPairs(const Scene& scene);

// Names an obstacle of `scene` that is neither disc nor plane, which is all that sequences, closed forms and
// conditions of optimality know; empty if there is nothing.
std::string BeyondPlanes(const Scene& scene);
// Names such an obstacle, or discs that spin: for methods that know only discs that do not.
std::string BeyondPlainDiscs(const Scene& scene);

}  // namespace saltus
