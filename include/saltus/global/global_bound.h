// Rigorous lower bounds of the loss of an optimal control problem with impacts, over all controls.
//
// The scene has discs without friction, quadratic terminal costs and a quadratic effort. A control is any force of
// finite effort on the pushed discs, not only one that is constant on intervals.
//
// An impact is relevant if the state after it of one of its two partners decides about the loss: because that disc has
// a terminal cost, or because a later relevant impact has it as a partner. Every motion has one sequence of relevant
// impacts. At given times and normals of these the least loss is that of a convex quadratic program: the discs fly from
// impact to impact, touch at each and approach each other there. Discs are on their side of each wall at the impacts
// that they take part in, and at the end if their place counts. The mean square of a force between impacts is within
// its bound. All else that a real motion respects (that discs do not overlap at other times) is left out, which only
// lowers the loss. The Lagrange dual function of that program is a lower bound for any multipliers. It is evaluated in
// interval arithmetic over boxes of times and normals, with multipliers that are best at the middle of the box.
//
// Branch and bound searches over sequences and boxes. A sequence is open, if one or more relevant impacts of any pairs
// follow, or closed. After the last impact of an open sequence, a disc gets no further than its largest speed takes it,
// which energy bounds; so the bound of an open sequence holds for all longer ones, whatever their length. An open box
// is halved, or replaced by the closed sequence and one open sequence for each pair that may follow.
//
// Motions whose impacts coincide count as limits of motions whose impacts do not.
#pragma once

#include <cstddef>
#include <functional>
#include <string>
#include <vector>

#include "saltus/control/contact_sequence.h"
#include "saltus/scene/scene.h"
#include "saltus/simulate/simulator.h"

namespace saltus {

// A part of all motions, with what is known of it.
struct SequenceBound {
  ContactSequence sequence;    // of the relevant impacts
  std::vector<char> repeated;  // by impact: the pair may touch again before one of its discs touches another one
  bool open = false;           // one or more relevant impacts follow
  double lower = 0;            // no motion in these boxes has a smaller loss, or none is better than GlobalBound::upper
  std::size_t boxes = 0;       // which are excluded, or left
};

// Holds the result of branch and bound, when it ends or at any time before.
struct GlobalBound {
  double upper = 0;                     // the loss of the known motion, as given
  double lower = 0;                     // no control has a smaller loss; never decreases
  std::size_t boxes = 0;                // bounded so far
  std::vector<SequenceBound> excluded;  // their bounds are above `upper`
  std::vector<SequenceBound> left;      // their bounds are below; the least first
  bool interrupted = false;             // ended by a limit, before the gap was reached

  double gap() const { return upper - lower; }
};

// Limits of branch and bound, and who is told of its progress.
struct GlobalOptions {
  double gap = 1e-6;                          // of the loss: ends as soon as upper - lower is at most this
  double seconds = 0;                         // limit of time; 0: no limit
  std::size_t boxes = 0;                      // limit of boxes; 0: no limit
  std::size_t memory = std::size_t{2} << 30;  // bytes of the queue, about; a limit as well
  StopRequest stop = nullptr;                 // returns true for the end
  std::function<void(const GlobalBound&)> progress = nullptr;  // called now and then, without `excluded` and `left`
};

// Returns the part of the scene that the bound does not support; empty if it supports all.
std::string WhyNotBounded(const Scene& scene);

// Bounds the loss of all controls of `scene` from below. `upper` is the loss of a motion that is known, such as that of
// the best control of `mode_search`: sequences and boxes above it are excluded. Precondition: WhyNotBounded is empty.
GlobalBound BoundGlobally(const Scene& scene, double upper, const GlobalOptions& options);

}  // namespace saltus
