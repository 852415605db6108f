#include "simulate/broad_phase.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <tuple>

namespace saltus {
namespace {

// The relative margin of all bounds, so that rounding never hides a pair.
constexpr double kMargin = 1e-6;

constexpr double kMostSteps = 1e9;
constexpr double kInfinity = std::numeric_limits<double>::infinity();

// Returns the first t >= 0 with closing * t + acceleration * t^2 >= gap. `closing` may be negative.
double TimeToCover(double gap, double closing, double acceleration) {
  if (gap <= 0) return 0;
  const double root = std::sqrt(closing * closing + 4 * acceleration * gap);
  if (closing < 0) return acceleration > 0 ? (root - closing) / (2 * acceleration) : kInfinity;
  return closing + root > 0 ? 2 * gap / (closing + root) : kInfinity;
}

// Cells of the grid in each direction; a power of two. The grid goes on periodically, so that no disc is outside: what
// far cells put into the same bucket is told apart by distance. At least 4, so that a cell's neighbours are different
// ones.
int GridWidth(int num_discs) {
  int width = 4;
  while (width * width < 2 * num_discs) width *= 2;
  return width;
}

}  // namespace

PartGrid::PartGrid(std::span<const WallPart> parts) : boxes_(parts.size()), seen_(parts.size(), 0) {
  Box all{{kInfinity, kInfinity}, {-kInfinity, -kInfinity}};
  for (std::size_t p = 0; p < parts.size(); ++p) {
    if (parts[p].extent.endless) continue;
    boxes_[p] = BoxOf(parts[p]);
    all.low = all.low.cwiseMin(boxes_[p].low);
    all.high = all.high.cwiseMax(boxes_[p].high);
    ++num_parts_;
  }
  if (num_parts_ == 0) return;
  // The grid has about as many cells as there are parts.
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

BroadPhase::BroadPhase(std::vector<WallPart> walls, std::vector<Disc> discs, const Options& options)
    : walls_(std::move(walls)),
      parts_(walls_),
      discs_(std::move(discs)),
      options_(options),
      acceleration_(discs_.size(), 0.0),
      now_(discs_.size()),
      speed_(discs_.size()),
      reach_(discs_.size()),
      margin_(discs_.size()),
      around_(discs_.size()) {
  smallest_radius_ = kInfinity;
  for (const Disc& disc : discs_) {
    largest_radius_ = std::max(largest_radius_, disc.radius);
    smallest_radius_ = std::min(smallest_radius_, disc.radius);
  }
}

void BroadPhase::SetAccelerations(std::span<const double> accelerations) {
  acceleration_.assign(accelerations.begin(), accelerations.end());
  for (int i = 0; i < num_discs(); ++i) {
    if (discs_[i].fixed) acceleration_[i] = 0;
  }
}

template <typename S>
int BroadPhase::Find(const S* x, int stride, std::vector<Candidate>* candidates) {
  for (int i = 0; i < num_discs(); ++i, x += stride) {
    now_[i].p = Vec2d(x[0], x[1]);
    now_[i].v = Vec2d(x[2], x[3]);
    if (discs_[i].gyration2 > 0) now_[i].turning = std::sqrt(discs_[i].gyration2) * x[5];
  }
  return FindInMotion(candidates);
}

template int BroadPhase::Find(const double*, int, std::vector<Candidate>*);
template int BroadPhase::Find(const float*, int, std::vector<Candidate>*);

int BroadPhase::FindInMotion(std::vector<Candidate>* candidates) {
  for (int i = 0; i < num_discs(); ++i) {
    speed_[i] = std::sqrt(Dot(now_[i].v, now_[i].v));
    margin_[i] = kMargin * (std::abs(now_[i].p[0]) + std::abs(now_[i].p[1]) + discs_[i].radius);
    SetReach(i);
  }
  candidates->clear();
  bool stands = ListStands();
  // Impacts may speed discs up within the step, which may add candidates, until the islands no longer grow.
  for (size_t before = 0;; before = candidates->size()) {
    if (!stands) {
      if (num_discs() <= options_.all_pairs) {
        ListAllPairs();
      } else {
        ListNearPairs();
      }
    }
    Collect(candidates);
    if (before == 0 && !candidates->empty() && HasNoContact(*candidates)) {
      candidates->clear();
      // With many discs some are as close again in the next step: a search for the number of steps without a meeting
      // would cost more than it saves.
      if (num_discs() > options_.all_pairs) return 1;
    }
    if (candidates->empty()) return QuietSteps();
    if (!options_.chains || candidates->size() == before || !BoundSpeedsByEnergy(*candidates)) return 1;
    stands = std::ranges::all_of(in_pairs_, [&](int i) { return ListStandsFor(i); });
  }
}

void BroadPhase::SetReach(int i) {
  const double dt = options_.dt;
  reach_[i] = (speed_[i] + acceleration_[i] * dt) * dt + margin_[i];
}

bool BroadPhase::ListStands() const {
  if (!listed_) return false;
  for (int i = 0; i < num_discs(); ++i) {
    if (!ListStandsFor(i)) return false;
  }
  return true;
}

bool BroadPhase::ListStandsFor(int i) const {
  if (skin_ == kInfinity) return true;
  const double left = 0.5 * skin_ - reach_[i];
  const Vec2d moved = now_[i].p - there_[i];
  return !(left < 0 || Dot(moved, moved) > left * left);
}

void BroadPhase::ListAllPairs() {
  list_.clear();
  for (int i = 0; i < num_discs(); ++i) {
    for (int j = i + 1; j < num_discs(); ++j) {
      if (!discs_[i].fixed || !discs_[j].fixed) list_.push_back({i, j, false});
    }
  }
  for (int i = 0; i < num_discs(); ++i) {
    for (int p = 0; !discs_[i].fixed && p < num_planes(); ++p) list_.push_back({i, p, true});
  }
  skin_ = kInfinity;
  listed_ = true;
}

void BroadPhase::ListNearPairs() {
  // With a wide skin the list is valid for long, but is long itself where discs are small and close to each other.
  const double reach = *std::max_element(reach_.begin(), reach_.end());
  skin_ = std::max(4 * reach, std::min(18 * reach, 3 * smallest_radius_));
  listed_ = true;
  list_.clear();
  there_.resize(num_discs());
  for (int i = 0; i < num_discs(); ++i) there_[i] = now_[i].p;
  // A disc whose numbers are not finite meets nothing and has no cell.
  if (!std::isfinite(std::accumulate(reach_.begin(), reach_.end(), 0.0))) return;

  const double near_gap = skin_ + options_.push_gap;
  SortIntoGrid(2 * largest_radius_ + near_gap);
  const int width = GridWidth(num_discs()), mask = width - 1;
  for (int i = 0; i < num_discs(); ++i) {
    const auto first = list_.size();
    const auto compare_with = [&](int begin, int end) {
      for (int at = begin; at < end; ++at) {
        const int j = bucket_[at];
        if (j <= i) continue;
        const Vec2d d = there_[i] - there_[j];
        const double near = discs_[i].radius + discs_[j].radius + near_gap;
        if (Dot(d, d) <= near * near && !(discs_[i].fixed && discs_[j].fixed)) list_.push_back({i, j, false});
      }
    };
    const int x = static_cast<int>(cell_x_[i]), y = static_cast<int>(cell_y_[i]);
    for (int above = -1; above <= 1; ++above) {
      const int row = ((y + above) & mask) * width;
      if (x > 0 && x < mask) {
        compare_with(bucket_start_[row + x - 1], bucket_start_[row + x + 2]);
      } else {
        for (int right = -1; right <= 1; ++right) {
          const int bucket = row + ((x + right) & mask);
          compare_with(bucket_start_[bucket], bucket_start_[bucket + 1]);
        }
      }
    }
    std::sort(list_.begin() + first, list_.end(), [](const auto& l, const auto& r) { return l.b < r.b; });
  }
  ListNearWalls(near_gap);
}

void BroadPhase::ListNearWalls(double near_gap) {
  for (int i = 0; i < num_discs(); ++i) {
    for (int p = 0; !discs_[i].fixed && p < num_planes(); ++p) {
      const double gap = Dot(walls_[p].wall.normal, there_[i]) - walls_[p].wall.offset - discs_[i].radius;
      if (gap <= near_gap || walls_[p].table) list_.push_back({i, p, true});
    }
  }
}

void BroadPhase::ListNearParts(int i) {
  Around& around = around_[i];
  const double touching = discs_[i].radius + options_.push_gap + reach_[i];
  // Lists are renewed well before they end: otherwise, of many discs, one list always ends soon, and all are checked.
  const double skin = std::max(4 * reach_[i], discs_[i].radius);
  if (LeastUnlistedDistance(i) > touching + 0.5 * skin) return;
  around.near = parts_.num_parts() <= options_.all_pairs ? kInfinity : touching + skin;
  around.listed_at = now_[i].p;
  parts_.FindNear(now_[i].p, around.near, &around.parts);
  around.least = -kInfinity;  // not looked at yet
}

void BroadPhase::CollectParts(int i, std::vector<Candidate>* candidates) {
  ListNearParts(i);
  const double touching = discs_[i].radius + options_.push_gap + reach_[i];
  if (LeastPartDistance(i) > touching) return;
  Around& around = around_[i];
  around.at = now_[i].p;
  around.least = LeastUnlistedDistance(i);
  for (int p : around.parts) {
    const double distance = walls_[p].LeastDistance(now_[i].p);
    around.least = std::min(around.least, distance);
    if (distance < touching && MayCount(i, p)) candidates->push_back({i, p, true});
  }
}

bool BroadPhase::MayCount(int i, int p) const {
  const WallPart& part = walls_[p];
  if (part.pocket) return true;
  const Vec2d& x = now_[i].p;
  const bool in_front = Separate<double>(x, part.wall).distance >= 0;
  if (!options_.all_parts) return in_front && part.extent.Covers(x);
  // A disc behind the wall can reach it around an end only.
  return in_front || !part.extent.Covers(x, -reach_[i]);
}

void BroadPhase::SortIntoGrid(double cell) {
  const int n = num_discs(), width = GridWidth(n);
  const auto bucket_of = [&](int i) { return cell_y_[i] * width + cell_x_[i]; };
  cell_x_.resize(n);
  cell_y_.resize(n);
  bucket_.resize(n);
  bucket_start_.assign(width * width + 1, 0);
  constexpr double kFarthest = 1e15;  // further out, cells no longer matter
  const auto cell_at = [&](double x) {
    return static_cast<std::int64_t>(std::clamp(std::floor(x / cell), -kFarthest, kFarthest)) & (width - 1);
  };
  for (int i = 0; i < n; ++i) {
    cell_x_[i] = cell_at(there_[i][0]);
    cell_y_[i] = cell_at(there_[i][1]);
    ++bucket_start_[bucket_of(i) + 1];
  }
  for (int b = 0; b < width * width; ++b) bucket_start_[b + 1] += bucket_start_[b];
  // The buckets are filled from behind: the end of each becomes its beginning.
  for (int i = n - 1; i >= 0; --i) bucket_[--bucket_start_[bucket_of(i) + 1]] = i;
  std::rotate(bucket_start_.begin(), bucket_start_.begin() + 1, bucket_start_.end());
  bucket_start_.back() = n;
}

void BroadPhase::Collect(std::vector<Candidate>* candidates) {
  candidates->clear();
  // These are copies, as the compiler must assume that adding a candidate changes the members.
  const Motion* const now = now_.data();
  const Disc* const discs = discs_.data();
  const double* const reach = reach_.data();
  const double push_gap = options_.push_gap;
  for (const Candidate& c : list_) {
    if (c.plane) {
      const Wall<double>& plane = walls_[c.b].wall;
      const double gap = Dot(plane.normal, now[c.a].p) - plane.offset - discs[c.a].radius;
      const bool near = gap < push_gap + reach[c.a] + kMargin * std::abs(plane.offset);
      if (near || walls_[c.b].table) candidates->push_back(c);
    } else {
      const Vec2d d = now[c.a].p - now[c.b].p;
      const double near = discs[c.a].radius + discs[c.b].radius + push_gap + reach[c.a] + reach[c.b];
      if (Dot(d, d) < near * near) candidates->push_back(c);
    }
  }
  if (parts_.num_parts() == 0) return;
  for (int i = 0; i < num_discs(); ++i) {
    if (!discs_[i].fixed) CollectParts(i, candidates);
  }
  const auto walls = std::ranges::find_if(*candidates, [](const Candidate& pair) { return pair.plane; });
  const auto before = [](const Candidate& l, const Candidate& r) { return std::tie(l.a, l.b) < std::tie(r.a, r.b); };
  if (num_planes() > 0) std::sort(walls, candidates->end(), before);
}

int BroadPhase::Root(int i) {
  while (parent_[i] != i) i = parent_[i] = parent_[parent_[i]];
  return i;
}

bool BroadPhase::BoundSpeedsByEnergy(std::span<const Candidate> candidates) {
  in_pairs_.clear();
  for (const Candidate& c : candidates) {
    if (!discs_[c.a].fixed) in_pairs_.push_back(c.a);
    if (!c.plane && !discs_[c.b].fixed) in_pairs_.push_back(c.b);
  }
  std::sort(in_pairs_.begin(), in_pairs_.end());
  in_pairs_.erase(std::unique(in_pairs_.begin(), in_pairs_.end()), in_pairs_.end());
  parent_.resize(num_discs());
  group_size_.resize(num_discs());
  energy_.resize(num_discs());
  for (int i : in_pairs_) {
    parent_[i] = i;
    group_size_[i] = 0;
    energy_[i] = 0;
  }
  for (const Candidate& c : candidates) {
    if (!c.plane && !discs_[c.a].fixed && !discs_[c.b].fixed) parent_[Root(c.a)] = Root(c.b);
  }
  for (int i : in_pairs_) ++group_size_[Root(i)];
  const auto may_gain = [&](int i) { return group_size_[Root(i)] > 1 || discs_[i].gyration2 > 0; };
  for (int i : in_pairs_) {
    if (!may_gain(i)) continue;
    const double speed = now_[i].v.norm();
    const double all = now_[i].turning == 0 ? speed : std::hypot(speed, now_[i].turning);
    const double fastest = all + acceleration_[i] * options_.dt;
    energy_[Root(i)] += discs_[i].mass * fastest * fastest;
  }
  bool any_gains = false;
  for (int i : in_pairs_) {
    if (!may_gain(i)) continue;
    // A group gains speed from forces too: each disc at most its own acceleration, times the mass ratio after impacts.
    const double bound = std::sqrt(energy_[Root(i)] / discs_[i].mass);
    if (!(bound > speed_[i])) continue;
    speed_[i] = bound;
    SetReach(i);
    any_gains = true;
  }
  return any_gains;
}

double BroadPhase::Drift(int i) const {
  // After n steps and the prediction of the next, a disc is off p + t v by at most a (t^2 + t dt) / 2, where `a` counts
  // what each step's rounding adds to position and velocity.
  const double dt = options_.dt;
  const double size = std::abs(now_[i].p[0]) + std::abs(now_[i].p[1]);
  return discs_[i].fixed ? 0.0 : acceleration_[i] + 4 * options_.rounding * (size / dt + speed_[i]) / dt;
}

double BroadPhase::TimeToMeet(const Candidate& c) const {
  const double dt = options_.dt;
  const auto time_to_cover = [&](double gap, double closing, double acceleration) {
    return TimeToCover(gap, closing + 0.5 * acceleration * dt, 0.5 * acceleration);
  };
  if (c.plane && !walls_[c.b].extent.endless) {
    const double gap = walls_[c.b].LeastDistance(now_[c.a].p) - discs_[c.a].radius - margin_[c.a] - options_.push_gap;
    return gap <= 0 ? 0.0 : time_to_cover(gap, walls_[c.b].Closing(now_[c.a].p, now_[c.a].v), Drift(c.a));
  }
  if (c.plane) {
    const Wall<double>& plane = walls_[c.b].wall;
    double gap = Dot(plane.normal, now_[c.a].p) - plane.offset - discs_[c.a].radius;
    gap -= margin_[c.a] + kMargin * std::abs(plane.offset);
    gap -= options_.push_gap;
    return gap <= 0 ? 0.0 : time_to_cover(gap, -Dot(plane.normal, now_[c.a].v), Drift(c.a));
  }
  const Vec2d d = now_[c.a].p - now_[c.b].p;
  const double distance = std::sqrt(Dot(d, d));
  const double gap =
      distance - discs_[c.a].radius - discs_[c.b].radius - margin_[c.a] - margin_[c.b] - options_.push_gap;
  if (gap <= 0) return 0;
  return time_to_cover(gap, -Dot(d, Vec2d(now_[c.a].v - now_[c.b].v)) / distance, Drift(c.a) + Drift(c.b));
}

double BroadPhase::TimeToMeetParts(int i, double enough) const {
  if (discs_[i].fixed) return enough;
  const double drift = Drift(i), touching = discs_[i].radius + margin_[i] + options_.push_gap;
  const auto time_to = [&](double distance) {
    return TimeToCover(distance - touching, speed_[i] + 0.5 * drift * options_.dt, 0.5 * drift);
  };
  if (time_to(LeastPartDistance(i)) >= enough) return enough;
  const auto reached_in = [&](double time) {
    return touching + time * (speed_[i] + 0.5 * drift * (options_.dt + time));
  };
  double least = std::min(enough, time_to(LeastUnlistedDistance(i)));
  double reached = reached_in(least);  // what is further is not met before then
  for (int p : around_[i].parts) {
    if (walls_[p].LeastDistance(now_[i].p) >= reached) continue;
    const double time = TimeToMeet({i, p, true});
    if (time >= least) continue;
    least = time;
    reached = reached_in(least);
  }
  return least;
}

bool BroadPhase::HasNoContact(std::span<const Candidate> pairs) const {
  return std::ranges::all_of(pairs, [&](const Candidate& c) {
    return !(c.plane && walls_[c.b].table) && TimeToMeet(c) * (1 - kMargin) >= options_.dt;
  });
}

int BroadPhase::QuietSteps() const {
  double quiet = kInfinity;
  for (const Candidate& c : list_) quiet = std::min(quiet, TimeToMeet(c));
  for (int i = 0; i < num_discs() && parts_.num_parts() > 0; ++i) quiet = TimeToMeetParts(i, quiet);
  if (skin_ < kInfinity) {
    for (int i = 0; i < num_discs(); ++i) {
      const double left = 0.5 * skin_ - (now_[i].p - there_[i]).norm() - margin_[i];
      quiet = std::min(quiet, TimeToCover(left, speed_[i], acceleration_[i]));
    }
  }
  return static_cast<int>(std::clamp(quiet / options_.dt * (1 - kMargin), 1.0, kMostSteps));
}

}  // namespace saltus
