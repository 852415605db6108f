// Which parts of edges (walls.h) are near a place: a uniform grid of cells over all of them, made once.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <span>
#include <vector>

#include "saltus/scene/walls.h"

namespace saltus {

class PartGrid {
 public:
  // The parts that are not endless, by their indices.
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
  // The cells that a box reaches into; those at the rim if it is outside.
  Cells CellsOf(const Box& box) const;

  int num_parts_ = 0;
  std::vector<Box> boxes_;                            // of all parts; of endless ones not used
  Vec2d low_ = Vec2d::Zero(), cell_ = Vec2d::Ones();  // m
  int width_ = 1;
  std::vector<int> start_, parts_;  // of each cell, row by row; where its parts begin
  std::vector<int> seen_;           // of each part, the search that has found it last
  int search_ = 0;
};

}  // namespace saltus
