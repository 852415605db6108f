// Lower bounds of the loss over all controls whose first relevant impacts are those of a box (see global_bound.h).
//
// With L the loss, c(u; theta) the conditions at impacts with parameters theta (that discs touch, and approach), and
// multipliers z of which those of approaches are not negative, weak duality gives for every control u that meets them
//
//   L(u) >= D(z; theta) = min over all u' of L(u') + z . c(u'; theta).
//
// D is a concave quadratic function of z, as L is a convex quadratic function of the control and c is linear in it. The
// bound of a box is a rigorous lower bound of D over theta, at the best of several multipliers.
#pragma once

#include <limits>
#include <memory>
#include <vector>

#include "saltus/control/contact_sequence.h"
#include "saltus/scene/scene.h"

namespace saltus::global {

// A sequence of impacts, and a box of their parameters. Each impact has its time, s; one of two discs also the
// direction of its normal: with tau in the box it is ((1 - tau^2), 2 tau) / (1 + tau^2), turned by `quarter` quarter
// turns.
struct ImpactBox {
  ContactSequence sequence;
  std::vector<int> quarters;      // one per impact; 0 of walls
  std::vector<double> low, high;  // of the parameters, impact by impact
  bool open = false;              // any relevant impacts of any pairs follow the last one; otherwise none
  bool free_normal = false;       // of the last impact, which then is one of two discs, and open

  // For each impact: the pair may touch again, any number of times, until one of its discs is in another impact of the
  // sequence.
  std::vector<char> repeated;

  // Returns before which impact the repetitions of impact i end; the number of impacts if they go on to the end.
  int EndOfRepetition(int i) const;
  // Whether the normal of impact i is free: then it has no second parameter.
  bool IsFree(int i) const { return free_normal && i + 1 == static_cast<int>(sequence.size()); }
  // Where the time of impact i stands among the parameters.
  int TimeIndex(int i) const;
  int num_parameters() const { return static_cast<int>(low.size()); }
};

// The last quarter of a turn ends where the next begins.
inline constexpr double kLargestTau = 0.4142135623730952;  // above tan(pi / 8)
inline constexpr int kMostParameters = 12;

struct DualTerms;  // the sides that a dual function has, and its weights

// Multipliers of a dual function. The bound of a box is rigorous whatever they are.
struct Multipliers {
  std::shared_ptr<const DualTerms> terms;
  // Two of each terminal term; those of each impact, which are one of its place at a wall and two between discs, and
  // one of its approach; and one of each side.
  std::vector<double> values;
};

struct BoxBound {
  double lower = 0;      // rigorous: no motion in the box has a smaller loss, unless it is above the upper bound given
  double at_middle = 0;  // in floating point: the bound at the middle of the box
  double least = 0;      // in floating point: about the least bound at points of the box, or one below the upper bound
  std::vector<double> low, high;  // the part of the box that motions with a loss below the upper bound given may be in
  double lower_outside = std::numeric_limits<double>::infinity();  // rigorous: of motions outside of that part
  int split = -1;  // the parameter in which the box should be halved; -1 if there is none
  std::shared_ptr<const Multipliers> multipliers;  // those of the greatest bound; null if there is none
};

class Relaxation {
 public:
  // Precondition: UnsupportedByGlobalBound(scene) is empty.
  explicit Relaxation(const Scene& scene);
  ~Relaxation();

  // `upper` is the loss of a known motion: those of larger loss need not be bounded. If `known` is not null, it has the
  // multipliers of a box that differs from this one in its parameters only: they are tried before others are computed.
  BoxBound Bound(const ImpactBox& box, double upper, const Multipliers* known = nullptr) const;

 private:
  class Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace saltus::global
