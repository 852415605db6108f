#include "saltus/dynamics/broad_phase.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

namespace saltus {
namespace {

// Rounding, single precision included, must never hide a pair.
constexpr double kMargin = 1e-6;

// The largest t with speed * t + acceleration * t^2 <= gap.
double TimeToCover(double gap, double speed, double acceleration) {
  if (gap <= 0) return 0;
  const double root = std::sqrt(speed * speed + 4 * acceleration * gap);
  const double denominator = speed + root;
  return denominator > 0 ? 2 * gap / denominator : std::numeric_limits<double>::infinity();
}

double Gap(const BroadPhase::Disc& a, const BroadPhase::Disc& b) {
  const double distance = (a.p - b.p).norm();
  return distance - a.radius - b.radius - kMargin * (1 + distance);
}

double Gap(const BroadPhase::Disc& disc, const HalfPlane<double>& plane) {
  const double distance = Dot(plane.normal, disc.p) - plane.offset;
  return distance - disc.radius - kMargin * (1 + std::abs(distance) + disc.p.cwiseAbs().maxCoeff());
}

int Root(std::vector<int>& parent, int i) {
  while (parent[i] != i) i = parent[i] = parent[parent[i]];
  return i;
}

}  // namespace

int BroadPhase::Find(std::span<const Disc> discs, std::vector<Candidate>* candidates) {
  candidates->clear();
  const int n = static_cast<int>(discs.size());
  speed_.resize(n);
  for (int i = 0; i < n; ++i) speed_[i] = discs[i].fixed ? 0.0 : discs[i].v.norm();

  double quiet = std::numeric_limits<double>::infinity();
  const auto consider = [&](double gap, double speed, double acceleration, const Candidate& candidate) {
    const double time = TimeToCover(gap - push_gap_, speed, acceleration);
    if (time < dt_) candidates->push_back(candidate);
    quiet = std::min(quiet, time);
  };
  const auto find = [&] {
    candidates->clear();
    for (int i = 0; i < n; ++i) {
      for (int j = i + 1; j < n; ++j) {
        if (discs[i].fixed && discs[j].fixed) continue;
        const double push = (discs[i].fixed ? 0 : discs[i].acceleration) + (discs[j].fixed ? 0 : discs[j].acceleration);
        consider(Gap(discs[i], discs[j]), speed_[i] + speed_[j], push, {i, j, false});
      }
    }
    for (int i = 0; i < n; ++i) {
      if (discs[i].fixed) continue;
      for (int p = 0; p < static_cast<int>(planes_.size()); ++p) {
        consider(Gap(discs[i], planes_[p]), speed_[i], discs[i].acceleration, {i, p, true});
      }
    }
  };
  find();
  if (candidates->empty()) {
    return static_cast<int>(std::min(quiet / dt_ * (1 - kMargin), 1e9));
  }
  if (chains_) {
    // Impacts may speed discs up within the step, which may add candidates, until the islands no longer grow.
    for (size_t before = 0; before != candidates->size();) {
      before = candidates->size();
      BoundSpeedsByEnergy(discs, *candidates);
      find();
    }
  }
  return 1;
}

void BroadPhase::BoundSpeedsByEnergy(std::span<const Disc> discs, std::span<const Candidate> candidates) {
  const int n = static_cast<int>(discs.size());
  std::vector<int> parent(n);
  std::iota(parent.begin(), parent.end(), 0);
  for (const Candidate& c : candidates) {
    if (!c.plane && !discs[c.a].fixed && !discs[c.b].fixed) parent[Root(parent, c.a)] = Root(parent, c.b);
  }
  std::vector<double> energy(n, 0.0);  // twice the kinetic energy that a group can have during the step
  std::vector<int> size(n, 0);
  for (int i = 0; i < n; ++i) {
    if (discs[i].fixed) continue;
    const double fastest = discs[i].v.norm() + discs[i].acceleration * dt_;
    energy[Root(parent, i)] += discs[i].mass * fastest * fastest;
    ++size[Root(parent, i)];
  }
  for (int i = 0; i < n; ++i) {
    const int root = Root(parent, i);
    // A group gains speed from forces too: each disc at most its own acceleration, times the mass ratio after impacts.
    if (size[root] > 1) speed_[i] = std::max(speed_[i], std::sqrt(energy[root] / discs[i].mass));
  }
}

std::vector<std::vector<int>> FindIslands(std::span<const Candidate> touches, std::span<const char> fixed) {
  std::vector<int> parent(fixed.size());
  std::iota(parent.begin(), parent.end(), 0);
  std::vector<int> moving;
  for (const Candidate& c : touches) {
    if (!fixed[c.a]) moving.push_back(c.a);
    if (!c.plane && !fixed[c.b]) moving.push_back(c.b);
    if (!c.plane && !fixed[c.a] && !fixed[c.b]) {
      const int a = Root(parent, c.a);
      const int b = Root(parent, c.b);
      parent[std::max(a, b)] = std::min(a, b);
    }
  }
  std::sort(moving.begin(), moving.end());
  moving.erase(std::unique(moving.begin(), moving.end()), moving.end());

  std::vector<std::vector<int>> islands;
  std::vector<int> island_of(fixed.size(), -1);
  for (int i : moving) {
    const int root = Root(parent, i);  // the smallest index of its island
    if (island_of[root] < 0) {
      island_of[root] = static_cast<int>(islands.size());
      islands.emplace_back();
    }
    islands[island_of[root]].push_back(i);
  }
  for (const Candidate& c : touches) {
    if (c.plane || fixed[c.a] == fixed[c.b]) continue;
    const int still = fixed[c.a] ? c.a : c.b;
    islands[island_of[Root(parent, fixed[c.a] ? c.b : c.a)]].push_back(still);
  }
  for (std::vector<int>& island : islands) {
    std::sort(island.begin(), island.end());
    island.erase(std::unique(island.begin(), island.end()), island.end());
  }
  return islands;
}

}  // namespace saltus
