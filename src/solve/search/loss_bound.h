// Lower bounds of the loss over all controls, whatever impacts they lead to: what a search need not look at, and when
// what it has found is the global optimum.
//
// Every motion either has no impact of a pushed disc, or a first one.
//
//   none           Pushed discs fly freely, each a linear-quadratic problem of its own that is solved in closed form;
//                  the others move as if no pushed disc were there.
//   a first one    Until then pushed discs fly freely and the others move as above. The least effort that brings the
//   of pair c      pair to a touch at time t, d(t) away from that where it drifts to, is 3 effort d^2 / (k t^3), with k
//                  the sum of 1/m^2 over its pushed discs; its least value over t is enclosed by branch and bound, the
//                  distance between two times by the speeds in between. After the touch, energy: impacts do not add
//                  any, and a force adds at most |u| / sqrt(m) to the square root s of twice the kinetic energy. So
//                  with effort E the discs get no further than their speeds s / sqrt(m_i) take them, and
//                  loss >= min over E of E + sum of weight (what each term misses at that reach)^2.
//
// Both hold for any control on so many intervals of any lengths; the second for any control at all.
#pragma once

#include <vector>

#include "saltus/control/contact_sequence.h"

namespace saltus {

class LossBound {
 public:
  // Precondition: UnsupportedByEventPhases() is empty.
  explicit LossBound(const Scene& scene);

  // The bound for all motions.
  double lowest() const { return lowest_; }
  // The bound for motions along a sequence: those without an impact of a pushed disc, or those with this first one.
  double BoundAlongSequence(const ContactSequence& sequence) const;

 private:
  struct First {
    Candidate pair;
    double loss = 0;
  };
  double lowest_ = 0;
  double without_impact_ = 0;
  std::vector<First> first_;
  std::vector<bool> pushed_;  // by disc
};

}  // namespace saltus
