// Rigorous lower bounds of the loss of an optimal control problem with impacts, over all controls, by branch and bound
// over sequences of impacts and boxes of their times and normals. docs/explanation/global-optima.md explains the
// method.
//
// The scene has discs without friction, quadratic terminal costs and a quadratic effort. A control is any force of
// finite effort on the controlled discs, not only one that is constant on intervals. An impact is relevant if one of
// its discs has a terminal cost or takes part in a later relevant impact. A sequence is open if one or more relevant
// impacts of any pairs follow, and closed otherwise; the bound of an open sequence holds for all longer ones. Motions
// whose impacts coincide are limits of motions whose impacts do not.
#pragma once

#include <cstddef>
#include <functional>
#include <string>
#include <vector>

#include "saltus/control/contact_sequence.h"
#include "saltus/scene/scene.h"
#include "saltus/simulate/simulator.h"

namespace saltus {

// The bound of the motions of a sequence.
struct SequenceBound {
  ContactSequence sequence;    // of the relevant impacts
  std::vector<char> repeated;  // for each impact: 1 if the pair may touch again before one of its discs touches another
  bool open = false;           // whether relevant impacts of any pairs may follow
  double lower = 0;            // no motion in these boxes has a loss below the smaller of this and GlobalBound::upper
  std::size_t boxes = 0;       // number of boxes that are excluded, or left
};

// The result of branch and bound, at its end or at any time before.
struct GlobalBound {
  double upper = 0;                     // the loss of the known motion, as given
  double lower = 0;                     // no control has a smaller loss; never decreases; at most `upper`
  std::size_t boxes = 0;                // bounded so far
  std::vector<SequenceBound> excluded;  // their bounds are above `upper`
  std::vector<SequenceBound> left;      // their bounds are below; the least first
  bool interrupted = false;             // ended by a limit, before the gap was reached

  double gap() const { return upper - lower; }
};

// Limits of branch and bound, and a callback for its progress.
struct GlobalOptions {
  double gap = 1e-6;                          // in the unit of the loss: ends as soon as upper - lower <= gap
  double seconds = 0;                         // limit of the CPU time of the process, s; 0: no limit
  std::size_t boxes = 0;                      // limit of boxes; 0: no limit
  std::size_t memory = std::size_t{2} << 30;  // approximate limit of the queue, bytes
  StopRequest stop = nullptr;                 // ends the search
  std::function<void(const GlobalBound&)> progress = nullptr;  // called repeatedly, without `excluded` and `left`
};

// Returns the part of the scene that the bound does not support; empty if it supports all.
std::string UnsupportedByGlobalBound(const Scene& scene);

// Bounds the loss of all controls of `scene` from below. `upper` is the loss of a known motion, such as that of the
// best control of `mode_search`: sequences and boxes with a bound above it are excluded, and those with a bound above
// `upper` less the gap are not divided further. Precondition: UnsupportedByGlobalBound() is empty.
GlobalBound BoundGlobally(const Scene& scene, double upper, const GlobalOptions& options);

}  // namespace saltus
