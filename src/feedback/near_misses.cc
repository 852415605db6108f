#include "feedback/near_misses.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <string>
#include <utility>

#include "saltus/scene/walls.h"
#include "simulate/interval_gaps.h"

namespace saltus {
namespace {

constexpr double kAtRest = 1e-9;    // of the speed of a disc: the rate of a gap that does not change
constexpr double kSameTime = 1e-6;  // of the length of an interval: events at the same time
constexpr double kNever = IntervalGaps::kNever;

// A flight with the derivatives of its state by the state at the beginning of the interval and by its control.
struct Start : FlightState {
  Eigen::MatrixXd A, B;
};

struct Change {
  Eigen::RowVectorXd by_state, by_control;
};

class IntervalEvents {
 public:
  IntervalEvents(const SceneIntervals& motion, int k, std::span<const double> force, const std::vector<double>& columns,
                 LinearInterval* interval)
      : motion_(motion),
        k_(k),
        simulator_(*motion[k].simulator),
        scene_(simulator_.scene()),
        size_(simulator_.body_size()),
        touches_(motion.touches(k)),
        force_(force),
        columns_(columns),
        walls_(WallPartsOf(scene_)),
        begin_(motion[k].begin),
        length_(motion[k].length),
        interval_(interval),
        at_begin_{{0, motion.State(k)},
                  Eigen::MatrixXd::Identity(interval->A.rows(), interval->A.rows()),
                  Eigen::MatrixXd::Zero(interval->B.rows(), interval->B.cols())},
        at_end_{{length_, motion.State(k + 1)}, interval->A, interval->B},
        gaps_(scene_, walls_, touches_, force, at_begin_, at_end_) {
    for (int later = k + 1; later < motion.size(); ++later) ends_ = ends_ && motion[later].simulator == nullptr;
  }

  void AddEvent(const SceneEvent& at) {
    const Touch& touch = touches_[at.touch];
    if (touch.time < 0) return;
    const GapPair pair = gaps_.PairOf(touch.candidate);
    LinearEvent event{.time = begin_ + touch.time, .name = NameOf(pair), .discs = at.discs};
    const Start start = StartBefore(touch);
    const Gap gap = gaps_.At(start, pair, touch.time);
    const double speed = std::max(gaps_.Velocity(start, pair.discs()[0], touch.time).norm(),
                                  gaps_.Velocity(start, pair.discs()[1], touch.time).norm());
    if (gap.rate < -kAtRest * speed) {
      const Change change = ChangeOfGap(start, pair, touch.time, gap.normal);
      event.by_state = -change.by_state / gap.rate;
      event.by_control = -change.by_control / gap.rate;
    } else {
      // The pair did not approach before: its event follows from another, or is a contact that begins without an
      // impact.
      const auto cause = std::ranges::find_if(interval_->events, [&](const LinearEvent& other) {
        return event.time - other.time <= kSameTime * length_ && SharesDisc(other.discs, event.discs);
      });
      if (cause == interval_->events.end()) return;
      event.immediate = true;
      event.by_state = cause->by_state;
      event.by_control = cause->by_control;
    }
    interval_->events.push_back(std::move(event));
  }

  void AddGuards() {
    for (int a = 0; a < scene_.num_bodies(); ++a) {
      for (int b = a + 1; b < scene_.num_bodies(); ++b) {
        if (!scene_.bodies[a].fixed || !scene_.bodies[b].fixed) AddLeastGaps({a, b, nullptr});
      }
      for (int wall = 0; !scene_.bodies[a].fixed && wall < static_cast<int>(walls_.size()); ++wall) {
        if (!walls_[wall].table) AddLeastGaps({a, wall, &walls_[wall]});
      }
    }
    for (const Touch& touch : touches_) {
      const GapPair pair = gaps_.PairOf(touch.candidate);
      if (touch.time < 0 || touch.time > gaps_.First(pair)) continue;
      if (touch.kind == ContactKind::kGrazing) AddGap(at_begin_, pair, touch.time, nullptr);
      if (touch.kind == ContactKind::kImpact && pair.wall == nullptr) AddOverlaps(pair);
    }
  }

 private:
  std::string NameOf(const GapPair& pair) const {
    return scene_.bodies[pair.a].name + " and " + (pair.wall != nullptr ? pair.wall->name : scene_.bodies[pair.b].name);
  }
  static bool SharesDisc(const std::vector<int>& discs, const std::vector<int>& others) {
    return std::ranges::any_of(discs, [&](int i) { return std::ranges::find(others, i) != others.end(); });
  }

  // A state before a touch behind which the discs of its pair have no event: that at the beginning of the interval, or
  // one in the middle between the touch and the last event of its discs before.
  Start StartBefore(const Touch& touch) const {
    double last = 0;
    for (const int i : gaps_.PairOf(touch.candidate).discs()) {
      for (const Touch& other : touches_) {
        const std::array<int, 2> discs = gaps_.PairOf(other.candidate).discs();
        if (other.kind == ContactKind::kSustained || (discs[0] != i && discs[1] != i)) continue;
        if (!scene_.bodies[i].fixed && other.time < touch.time - kSameTime * length_) last = std::max(last, other.time);
      }
    }
    if (last == 0) return at_begin_;
    Start start{{0.5 * (last + touch.time), std::vector<double>(at_begin_.x.size())}, {}, {}};
    const std::unique_ptr<Simulator> part = motion_.MakeStep(k_, start.time);
    part->Step(at_begin_.x, force_, start.x);
    StepLinearization step;
    part->Linearize(at_begin_.x, force_, /*with_parameters=*/false, &step);
    Eigen::MatrixXd by_force;
    step.ToDense(&start.A, &by_force);
    start.B = Select(by_force, columns_);
    return start;
  }

  // The derivatives of the gap at a fixed time.
  Change ChangeOfGap(const Start& start, const GapPair& pair, double t, const Vec2d& normal) const {
    const double s = t - start.time;
    Eigen::RowVectorXd by_start = Eigen::RowVectorXd::Zero(start.A.rows());
    Eigen::MatrixXd by_force = Eigen::MatrixXd::Zero(1, static_cast<Eigen::Index>(force_.size()));
    const auto add = [&](int i, double side) {
      if (scene_.bodies[i].fixed) return;
      for (int j = 0; j < 2; ++j) {
        by_start[size_ * i + j] = side * normal[j];
        by_start[size_ * i + 2 + j] = s * side * normal[j];
        by_force(0, 2 * i + j) = 0.5 * s * s / scene_.bodies[i].mass * side * normal[j];
      }
    };
    add(pair.a, 1);
    if (pair.wall == nullptr) add(pair.b, -1);
    return {by_start * start.A, by_start * start.B + Select(by_force, columns_)};
  }

  void AddLeastGaps(const GapPair& pair) {
    if (IntervalGaps::Touches(touches_, pair)) return;
    const double first = gaps_.First(pair);
    if (first == kNever) {
      if (AddLeastGap(at_begin_, pair, 0, length_) && ends_) AddGap(at_begin_, pair, length_, nullptr);
      return;
    }
    const double last = gaps_.Last(pair);
    const bool falls = AddLeastGap(at_begin_, pair, 0, first);
    if (falls && gaps_.At(at_end_, pair, last).rate >= 0) {
      const auto turns = std::ranges::find(interval_->events, begin_ + first, &LinearEvent::time);
      if (turns != interval_->events.end()) AddGap(at_begin_, pair, first, &*turns);
    }
    if (AddLeastGap(at_end_, pair, last, length_) && ends_) AddGap(at_end_, pair, length_, nullptr);
  }

  // Adds the least gap between two times, if the gap falls before it and rises behind it, and gaps of a pair that
  // touches without a force. Returns whether the gap still falls at the end, or is still zero.
  bool AddLeastGap(const Start& start, const GapPair& pair, double from, double to) {
    const Gap before = gaps_.At(start, pair, from);
    const double touching = gaps_.Touching(pair);
    if (before.value <= touching) {
      if (start.time > 0 || before.value < -touching) return false;
      const auto [i, j] = pair.discs();
      const double speed = std::max(gaps_.Velocity(start, i, to).norm(), gaps_.Velocity(start, j, to).norm());
      const bool stays = gaps_.At(start, pair, to).rate <= kAtRest * speed;
      // Disturbances of the process come at the ends of intervals, so the first interval of a motion has none.
      const bool begins = k_ == 1 || (k_ > 1 && IntervalGaps::Touches(motion_.touches(k_ - 1), pair));
      const auto touched = [&] { return gaps_.At({0, motion_.State(k_ - 1)}, pair, 0).value <= touching; };
      if (k_ == 0 || (!stays && !begins && touched())) AddGap(start, pair, from, nullptr);
      if (stays && begins) AddGap(start, pair, to, nullptr);
      return stays;
    }
    if (gaps_.At(start, pair, to).rate < 0) return true;
    if (const auto least = gaps_.LeastBetween(start, pair, from, to)) AddGap(start, pair, *least, nullptr);
    return false;
  }

  // Adds the gap at a time, which is that of an event where `turns` is given.
  void AddGap(const Start& start, const GapPair& pair, double t, const LinearEvent* turns) {
    if (pair.wall != nullptr && !pair.wall->extent.Covers(gaps_.Position(start, pair.a, t))) return;
    const Gap gap = gaps_.At(start, pair, t);
    Change change = ChangeOfGap(start, pair, t, gap.normal);
    if (turns != nullptr) {
      change.by_state += gap.rate * turns->by_state;
      change.by_control += gap.rate * turns->by_control;
    }
    interval_->guards.push_back({.name = "the gap of " + NameOf(pair),
                                 .time = begin_ + t,
                                 .value = std::max(gap.value, 0.0),
                                 .by_state = std::move(change.by_state),
                                 .by_control = std::move(change.by_control)});
  }

  // Adds by how much the paths of two discs that collide overlap, across their relative velocity w: the sum d of their
  // radii minus the offset across, which is cross(r, w) / |w| for the relative position r, on either side.
  void AddOverlaps(const GapPair& pair) {
    const int a = size_ * pair.a, b = size_ * pair.b;
    const Vec2d r = gaps_.Position(at_begin_, pair.a, 0) - gaps_.Position(at_begin_, pair.b, 0);
    const Vec2d w = gaps_.Velocity(at_begin_, pair.a, 0) - gaps_.Velocity(at_begin_, pair.b, 0);
    const double speed = w.norm();
    if (!(speed > 0)) return;
    const double offset = (r[0] * w[1] - r[1] * w[0]) / speed;
    const Vec2d by_r = Vec2d(w[1], -w[0]) / speed;
    const Vec2d by_w = Vec2d(-r[1], r[0]) / speed - offset / (speed * speed) * w;
    for (const double side : {-1.0, 1.0}) {
      LinearGuard guard{.name = "the overlap of the paths of " + NameOf(pair),
                        .time = begin_,
                        .value = scene_.bodies[pair.a].radius + scene_.bodies[pair.b].radius + side * offset,
                        .by_state = Eigen::RowVectorXd::Zero(interval_->A.cols()),
                        .by_control = Eigen::RowVectorXd::Zero(interval_->B.cols())};
      if (!(guard.value > 0)) continue;
      for (int j = 0; j < 2; ++j) {
        guard.by_state[a + j] = side * by_r[j];
        guard.by_state[b + j] = -side * by_r[j];
        guard.by_state[a + 2 + j] = side * by_w[j];
        guard.by_state[b + 2 + j] = -side * by_w[j];
      }
      interval_->guards.push_back(std::move(guard));
    }
  }

  const SceneIntervals& motion_;
  const int k_;
  const Simulator& simulator_;
  const Scene& scene_;
  const int size_;
  const std::span<const Touch> touches_;
  const std::span<const double> force_;
  const std::vector<double>& columns_;
  const std::vector<WallPart> walls_;
  const double begin_, length_;
  LinearInterval* interval_;
  const Start at_begin_, at_end_;
  const IntervalGaps gaps_;
  bool ends_ = true;  // the motion, with this interval
};

}  // namespace

void AddEventsAndNearMisses(const SceneIntervals& motion, int k, std::span<const SceneEvent> events,
                            std::span<const double> force, const std::vector<double>& columns,
                            LinearInterval* interval) {
  IntervalEvents found(motion, k, force, columns, interval);
  for (const SceneEvent& event : events) found.AddEvent(event);
  found.AddGuards();
}

Eigen::MatrixXd Select(const Eigen::MatrixXd& by_force, const std::vector<double>& columns) {
  Eigen::MatrixXd by_control(by_force.rows(), static_cast<Eigen::Index>(columns.size()));
  for (std::size_t j = 0; j < columns.size(); ++j) {
    by_control.col(static_cast<Eigen::Index>(j)) = by_force.col(static_cast<Eigen::Index>(columns[j]));
  }
  return by_control;
}

}  // namespace saltus
