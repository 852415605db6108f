#include "simulate/part_grid.h"

#include <limits>

namespace saltus {

PartGrid::PartGrid(std::span<const WallPart> parts) : boxes_(parts.size()), seen_(parts.size(), 0) {
  constexpr double kInfinity = std::numeric_limits<double>::infinity();
  Box all{{kInfinity, kInfinity}, {-kInfinity, -kInfinity}};
  for (std::size_t p = 0; p < parts.size(); ++p) {
    if (parts[p].extent.endless) continue;
    boxes_[p] = BoxOf(parts[p]);
    all.low = all.low.cwiseMin(boxes_[p].low);
    all.high = all.high.cwiseMax(boxes_[p].high);
    ++num_parts_;
  }
  if (num_parts_ == 0) return;
  // About as many cells as parts.
  width_ = static_cast<int>(std::ceil(std::sqrt(num_parts_)));
  low_ = all.low;
  for (int j = 0; j < 2; ++j) cell_[j] = all.high[j] > all.low[j] ? (all.high[j] - all.low[j]) / width_ : 1.0;

  const auto for_each_cell = [&](const auto& visit) {
    for (std::size_t p = 0; p < parts.size(); ++p) {
      if (parts[p].extent.endless) continue;
      const Cells cells = CellsOf(boxes_[p]);
      for (int y = cells.first[1]; y <= cells.last[1]; ++y) {
        for (int x = cells.first[0]; x <= cells.last[0]; ++x) visit(y * width_ + x, static_cast<int>(p));
      }
    }
  };
  start_.assign(width_ * width_ + 1, 0);
  for_each_cell([&](int cell, int) { ++start_[cell + 1]; });
  for (std::size_t cell = 1; cell < start_.size(); ++cell) start_[cell] += start_[cell - 1];
  parts_.resize(start_.back());
  std::vector<int> next(start_.begin(), start_.end() - 1);
  for_each_cell([&](int cell, int part) { parts_[next[cell]++] = part; });
}

PartGrid::Box PartGrid::BoxOf(const WallPart& part) {
  if (!part.wall.curved()) return {part.from.cwiseMin(part.to), part.from.cwiseMax(part.to)};
  const Vec2d half(part.wall.radius, part.wall.radius);
  return {part.wall.center - half, part.wall.center + half};
}

PartGrid::Cells PartGrid::CellsOf(const Box& box) const {
  const auto cell_at = [&](double x, int j) {
    return static_cast<int>(std::clamp(std::floor((x - low_[j]) / cell_[j]), 0.0, width_ - 1.0));
  };
  return {{cell_at(box.low[0], 0), cell_at(box.low[1], 1)}, {cell_at(box.high[0], 0), cell_at(box.high[1], 1)}};
}

void PartGrid::FindNear(const Vec2d& x, double distance, std::vector<int>* near) {
  near->clear();
  if (num_parts_ == 0 || !x.allFinite()) return;
  ++search_;
  const Vec2d half(distance, distance);
  const Cells cells = CellsOf({x - half, x + half});
  for (int row = cells.first[1]; row <= cells.last[1]; ++row) {
    // The cells of a row follow each other.
    const int begin = start_[row * width_ + cells.first[0]], end = start_[row * width_ + cells.last[0] + 1];
    for (int at = begin; at < end; ++at) {
      const int part = parts_[at];
      if (seen_[part] == search_) continue;
      seen_[part] = search_;
      const Box& box = boxes_[part];
      const bool apart = ((box.low - x).array() > distance).any() || ((x - box.high).array() > distance).any();
      if (!apart) near->push_back(part);
    }
  }
  std::sort(near->begin(), near->end());
}

}  // namespace saltus
