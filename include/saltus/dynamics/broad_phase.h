// Which discs can touch within one step, whatever contact model resolves it.
//
// A disc cannot leave the ball of radius
//   reach = (|v| + |a| dt) dt
// around its position before the step ends, for any of the integrators. A pair is a candidate if its gap is no larger
// than its reaches, plus the gap from which on the model lets bodies push each other (ModelTraits::reach). Where
// impacts can follow each other within a step (ModelTraits::chains), the speed of a disc is bounded by the kinetic
// energy of all discs that it can meet, and candidates are extended until they no longer grow.
#pragma once

#include <span>
#include <vector>

#include "saltus/contact/contact_model.h"

namespace saltus {

class BroadPhase {
 public:
  struct Disc {
    Vec2d p, v;
    double acceleration;  // m/s^2, magnitude
    double radius;
    double mass;
    bool fixed;
  };

  // `push_gap`: ModelTraits::reach, m.
  BroadPhase(std::vector<HalfPlane<double>> planes, double dt, bool chains, double push_gap)
      : planes_(std::move(planes)), dt_(dt), chains_(chains), push_gap_(push_gap) {}

  // Overwrites `candidates`: discs by index pairs, then discs against planes. Returns for how many steps, this one
  // included, the list stands: one if there are candidates; otherwise as long as no disc can have met another, if the
  // accelerations are bounds for that time (zero if the next step is already uncertain).
  int Find(std::span<const Disc> discs, std::vector<Candidate>* candidates);

 private:
  // Raises speed_ to what impacts within the groups that `candidates` connect can give each disc.
  void BoundSpeedsByEnergy(std::span<const Disc> discs, std::span<const Candidate> candidates);

  std::vector<HalfPlane<double>> planes_;
  double dt_;
  bool chains_;
  double push_gap_;
  std::vector<double> speed_;  // m/s, bound per disc
};

// Groups of discs connected by `touches`, each sorted, in order of their first moving disc. Fixed discs and planes
// connect nothing; a fixed disc belongs to every island that touches it. `fixed[i]` says whether disc i is fixed.
std::vector<std::vector<int>> FindIslands(std::span<const Candidate> touches, std::span<const char> fixed);

}  // namespace saltus
