// The pairs of discs that can touch within one step, whatever contact model resolves it.
//
// A disc cannot leave the ball of radius
//   reach = (|v| + |a| dt) dt
// around its position before the step ends, for any of the integrators. A pair is a candidate if its gap is no larger
// than its reaches, plus the gap from which on the model lets bodies push each other (ModelTraits::push_gap). Where
// impacts can follow each other within a step (ModelTraits::chains), the speed of a disc is bounded by the kinetic
// energy of all discs that it can meet, that of their spin included, and candidates are extended until they no longer
// grow.
//
// Few discs are compared all with all. Of many, a list of near pairs is kept (Verlet 1967), found with a uniform grid:
// all pairs whose gap is at most `skin` more than that. It stands as long as no disc can have moved by more than half
// of that.
//
// Of the parts of edges (walls.h), near pairs come from a grid of their own (PartGrid). They are looked at again
// when the disc can have come near the nearest of them. A part is a candidate for a disc where it counts at the start
// of the step, on the disc's side; or, for models that look ahead (all_parts), wherever it may do so before the end.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "saltus/contact/step_input.h"
#include "saltus/scene/walls.h"

namespace saltus {

// A uniform grid of cells over all parts of edges, made once, which finds the parts near a place.
class PartGrid {
 public:
  // Holds the parts that are not endless, by their indices.
  explicit PartGrid(std::span<const WallPart> parts);

  int num_parts() const { return num_parts_; }

  // Overwrites `near`, rising, with the parts whose bounding boxes are no further than `distance` from that of x, m;
  // none if x is not finite.
  void FindNear(const Vec2d& x, double distance, std::vector<int>* near);

 private:
  struct Box {
    Vec2d low, high;
  };
  struct Cells {
    std::array<int, 2> first, last;
  };
  static Box BoxOf(const WallPart& part);
  // Returns the cells that a box reaches into; the cells at the rim if it is outside.
  Cells CellsOf(const Box& box) const;

  int num_parts_ = 0;
  std::vector<Box> boxes_;                            // of all parts; of endless ones not used
  Vec2d low_ = Vec2d::Zero(), cell_ = Vec2d::Ones();  // m
  int width_ = 1;
  std::vector<int> start_, parts_;  // of each cell, row by row; where its parts begin
  std::vector<int> seen_;           // of each part, the search that has found it last
  int search_ = 0;
};

class BroadPhase {
 public:
  struct Disc {
    double radius;
    double mass;
    bool fixed;
    double gyration2 = 0;  // m^2, square of the radius of gyration of a disc that spins; else 0
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
  // numbers from one disc to the next; of one that spins, its angular velocity is the sixth. Discs that are not finite
  // meet nothing.
  template <typename S>
  int Find(const S* x, int stride, std::vector<Candidate>* candidates);

 private:
  struct Motion {
    Vec2d p, v;
    double turning = 0;  // m/s, radius of gyration times angular velocity
  };

  int num_planes() const { return static_cast<int>(walls_.size()) - parts_.num_parts(); }
  int num_discs() const { return static_cast<int>(discs_.size()); }
  int FindInMotion(std::vector<Candidate>* candidates);
  // Sets reach_[i] from the speed of disc i, with a margin for rounding.
  void SetReach(int i);
  bool ListStands() const;
  bool ListStandsFor(int i) const;  // as far as disc i is concerned
  void ListAllPairs();
  void ListNearPairs();
  void SortIntoGrid(double cell);
  void ListNearWalls(double near_gap);
  // Lists the parts of edges near disc i, unless the list stands.
  void ListNearParts(int i);
  void Collect(std::vector<Candidate>* candidates);
  void CollectParts(int i, std::vector<Candidate>* candidates);
  // Whether part p of an edge may count for disc i within the step.
  bool MayCount(int i, int p) const;
  // Raises speed_ and reach_ to what impacts within the groups that `candidates` connect can give each disc in them.
  // Returns whether any is raised.
  bool BoundSpeedsByEnergy(std::span<const Candidate> candidates);
  int Root(int i);
  // Whether none of these pairs can meet in this step: a disc may have the reach but move away.
  bool HasNoContact(std::span<const Candidate> pairs) const;
  // Returns for how many steps nothing meets. Precondition: nothing can meet in this step.
  int QuietSteps() const;
  double TimeToMeet(const Candidate& pair) const;
  // Returns a lower bound on the time until disc i meets a part of an edge near it, s; `enough` if it is no less.
  double TimeToMeetParts(int i, double enough) const;
  // Returns a bound on the acceleration of disc i, with the contribution of rounding, m/s^2.
  double Drift(int i) const;
  // Bounds on the distance of disc i to any part of an edge, and to the parts that are not listed for it, m.
  double LeastPartDistance(int i) const { return around_[i].least - (now_[i].p - around_[i].at).norm(); }
  double LeastUnlistedDistance(int i) const { return around_[i].near - (now_[i].p - around_[i].listed_at).norm(); }

  std::vector<WallPart> walls_;
  PartGrid parts_;
  std::vector<Disc> discs_;
  Options options_;
  std::vector<double> acceleration_;

  std::vector<Motion> now_;
  std::vector<double> speed_, reach_, margin_;  // m/s, m, m, bounds for this step

  std::vector<Candidate> list_;  // near pairs, discs by index pairs, then discs against planes
  // The parts of edges near a disc.
  struct Around {
    std::vector<int> parts;
    Vec2d listed_at = Vec2d::Zero();  // where it was when they were listed, ...
    double near = -1;                 // m, ... all that were so near
    Vec2d at = Vec2d::Zero();         // where it was when they were last looked at, ...
    double least = 0;                 // m, ... and a bound on the distance to any part then
  };
  std::vector<Around> around_;
  bool listed_ = false;
  double skin_ = 0;             // m; infinite if the list has all pairs
  std::vector<Vec2d> there_;    // positions when it was made
  double largest_radius_ = 0;   // m
  double smallest_radius_ = 0;  // m

  // Data of the discs that the latest candidates contain.
  std::vector<int> in_pairs_;             // ascending, without those that are fixed
  std::vector<int> parent_, group_size_;  // of each of these discs: in its group, and of a root the group's size
  std::vector<double> energy_;            // of a root: twice the kinetic energy that its group can have in the step

  // The grid: discs sorted by the hash of their cell.
  std::vector<std::int64_t> cell_x_, cell_y_;
  std::vector<int> bucket_start_, bucket_;
};

}  // namespace saltus
