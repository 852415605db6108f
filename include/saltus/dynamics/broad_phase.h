// Which discs can touch within one step, whatever contact model resolves it.
//
// A disc cannot leave the ball of radius
//   reach = (|v| + |a| dt) dt
// around its position before the step ends, for any of the integrators. A pair is a candidate if its gap is no larger
// than its reaches, plus the gap from which on the model lets bodies push each other (ModelTraits::push_gap). Where
// impacts can follow each other within a step (ModelTraits::chains), the speed of a disc is bounded by the kinetic
// energy of all discs that it can meet, and candidates are extended until they no longer grow.
//
// Few discs are compared all with all. Of many, a list of near pairs is kept (Verlet 1967), found with a uniform grid:
// all pairs whose gap is at most `skin` more than that. It stands as long as no disc can have moved by more than half
// of that.
//
// Of the parts of edges (walls.h), near pairs come from a grid of their own (part_grid.h). A part is a candidate for a
// disc where it counts at the start of the step, on the disc's side; or, for models that look ahead (all_parts),
// wherever it may do so before the end.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "saltus/contact/contact_model.h"
#include "saltus/dynamics/part_grid.h"
#include "saltus/physics/walls.h"

namespace saltus {

class BroadPhase {
 public:
  struct Disc {
    double radius;
    double mass;
    bool fixed;
  };
  struct Options {
    double dt;               // s
    bool chains;             // as ModelTraits::chains
    double push_gap;         // m, ModelTraits::push_gap
    double rounding;         // relative error of one operation of the simulation
    bool all_parts = false;  // edges: all that may be met, not only those that count at the start
    int all_pairs = 16;      // up to so many discs, and parts of edges, all pairs are compared
  };

  BroadPhase(std::vector<WallPart> walls, std::vector<Disc> discs, const Options& options);

  // Bounds on the accelerations of the discs in the steps to come, m/s^2.
  void SetAccelerations(std::span<const double> accelerations);

  // Overwrites `candidates`: discs by index pairs, then discs against planes. Returns for how many steps, this one
  // included, the list stands, at least 1: one if there are candidates; otherwise as long as no disc can have met
  // another while the accelerations stay within their bounds. `x` has [p_x p_y v_x v_y ...] of each disc, `stride`
  // numbers from one disc to the next. Discs that are not finite meet nothing.
  template <typename S>
  int Find(const S* x, int stride, std::vector<Candidate>* candidates);

 private:
  struct Motion {
    Vec2d p, v;
  };

  int num_discs() const { return static_cast<int>(discs_.size()); }
  int FindInMotion(std::vector<Candidate>* candidates);
  // reach_ from the speeds, with a margin for rounding.
  void SetReaches();
  bool ListStands() const;
  void ListAllPairs();
  void ListNearPairs();
  void SortIntoGrid(double cell);
  void ListNearWalls(double near_gap);
  void Collect(std::vector<Candidate>* candidates) const;
  // Whether disc i may touch part p of an edge within the step.
  bool MayTouchPart(int i, int p) const;
  // Raises speed_ to what impacts within the groups that `candidates` connect can give each disc.
  void BoundSpeedsByEnergy(std::span<const Candidate> candidates);
  int Root(int i);
  // For how many steps nothing meets, if nothing can in this one.
  int QuietSteps() const;
  double TimeToMeet(const Candidate& pair) const;

  std::vector<WallPart> walls_;
  PartGrid parts_;
  std::vector<Disc> discs_;
  Options options_;
  std::vector<double> acceleration_;

  std::vector<Motion> now_;
  std::vector<double> speed_, reach_, margin_;  // m/s, m, m, bounds for this step

  std::vector<Candidate> list_;  // near pairs, discs by index pairs, then discs against planes
  bool listed_ = false;
  double skin_ = 0;             // m; infinite if the list has all pairs
  std::vector<Vec2d> there_;    // positions when it was made
  double largest_radius_ = 0;   // m
  double smallest_radius_ = 0;  // m

  std::vector<int> near_parts_;

  std::vector<int> parent_, group_size_;
  std::vector<double> energy_;

  // The grid: discs sorted by the hash of their cell.
  std::vector<std::int64_t> cell_x_, cell_y_;
  std::vector<int> bucket_start_, bucket_;
};

}  // namespace saltus
