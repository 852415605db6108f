// The contacts of a rollout, their costates, and what of their errors is due to finite steps.
#include "saltus/audit/attribution.h"

#include <glog/logging.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstdio>
#include <numeric>
#include <utility>

#include "audit/attribution/attributor.h"
#include "base/parallel_for.h"
#include "saltus/control/objective.h"
#include "saltus/scene/geometry.h"
#include "saltus/simulate/registry.h"
#include "scene/units.h"
#include "solve/phases/phase_run.h"

namespace saltus {
namespace internal {
namespace {

constexpr double kTouching = 1e-11;  // overlap that is none
constexpr int kMargin = 2;           // steps by which an interval may grow to find the exact impact

}  // namespace

std::string Attributor::PairName(const Candidate& pair) const {
  return scene_.bodies[pair.a].name + " - " + (pair.plane ? walls_[pair.b].name : scene_.bodies[pair.b].name);
}

bool Attributor::Overlap(const Interval& interval, int k) const {
  const std::vector<double> x = PlainStateAt(k);
  const auto position = [&](int i) { return Vec2d(x[size_ * i], x[size_ * i + 1]); };
  return std::any_of(interval.meetings.begin(), interval.meetings.end(), [&](const Meeting& meeting) {
    const Candidate& pair = meeting.pair;
    const double radius = scene_.bodies[pair.a].radius;
    if (pair.plane) {
      return Separate<double>(position(pair.a), walls_[pair.b].wall).distance < radius - kTouching;
    }
    return (position(pair.a) - position(pair.b)).norm() < radius + scene_.bodies[pair.b].radius - kTouching;
  });
}

bool Attributor::Involves(const Interval& interval, const Candidate& pair) const {
  const auto shares = [&](int body, const Candidate& other) {
    return !scene_.bodies[body].fixed && (body == other.a || (!other.plane && body == other.b));
  };
  return std::any_of(interval.meetings.begin(), interval.meetings.end(), [&](const Meeting& meeting) {
    return shares(pair.a, meeting.pair) || (!pair.plane && shares(pair.b, meeting.pair));
  });
}

void Attributor::AddTouch(const StepTouch& at, std::vector<Interval>* intervals) const {
  const auto belongs = [&](const Interval& interval) {
    return at.step <= interval.end && at.step - interval.begin < kLongest && Involves(interval, at.touch.candidate);
  };
  Interval joined{at.step, at.step + 1, {{at.touch.candidate, at.step, at.step}}};
  for (const Interval& interval : *intervals) {
    if (!belongs(interval)) continue;
    joined.begin = std::min(joined.begin, interval.begin);
    joined.end = std::max(joined.end, interval.end);
    for (const Meeting& meeting : interval.meetings) {
      if (meeting.pair == at.touch.candidate) {
        joined.meetings.front().first = std::min(meeting.first, joined.meetings.front().first);
      } else {
        joined.meetings.push_back(meeting);
      }
    }
  }
  std::erase_if(*intervals, belongs);
  while (joined.end < model_->num_steps() && joined.end - joined.begin < kLongest && Overlap(joined, joined.end)) {
    ++joined.end;
  }
  intervals->push_back(std::move(joined));
}

std::vector<Interval> Attributor::FindIntervals() const {
  std::vector<Interval> intervals;
  for (const StepTouch& at : model_->touches()) {
    AddTouch(at, &intervals);
    if (intervals.size() > Attribution::kMostContacts) {
      intervals.pop_back();
      break;
    }
  }
  std::stable_sort(intervals.begin(), intervals.end(), [](const Interval& a, const Interval& b) {
    return a.first_touch() < b.first_touch();
  });
  for (size_t i = 0; i < intervals.size(); ++i) {
    Interval& interval = intervals[i];
    // Neighbours in time that share a disc.
    int from = 0, to = model_->num_steps();
    for (size_t j = 0; j < intervals.size(); ++j) {
      const bool shares = std::any_of(intervals[j].meetings.begin(),
                                      intervals[j].meetings.end(),
                                      [&](const Meeting& meeting) { return Involves(interval, meeting.pair); });
      if (j == i || !shares) continue;
      if (j < i) from = std::max(from, intervals[j].end);
      if (j > i) to = std::min(to, intervals[j].begin);
    }
    const auto full = [&] { return interval.end - interval.begin >= kLongest; };
    while (interval.begin > from && !full() && Overlap(interval, interval.begin)) --interval.begin;
    for (int margin = 0; margin < kMargin && !full() && !HasExactImpact(interval); ++margin) {
      if (interval.begin > from) --interval.begin;
      if (interval.end < to) ++interval.end;
    }
  }
  return intervals;
}

bool Attributor::HasExactImpact(const Interval& interval) const {
  const std::vector<StepTouch> touches = ExactTouches(interval);
  return std::any_of(
      touches.begin(), touches.end(), [&](const StepTouch& at) { return Involves(interval, at.touch.candidate); });
}

// One sweep of the model's own adjoint from the end.
void Attributor::FindCostates(const std::vector<Interval>& intervals) {
  std::vector<double> lambda(model_->state_size()), before(lambda.size()), u(model_->force_size());
  std::vector<double> unused(u.size());
  TerminalGradient(scene_.objective, StateAt(model_->num_steps()), model_->body_size(), lambda);
  costates_.resize(intervals.size());
  std::vector<size_t> order(intervals.size());
  std::iota(order.begin(), order.end(), size_t{0});
  std::sort(order.begin(), order.end(), [&](size_t a, size_t b) { return intervals[a].end > intervals[b].end; });
  StepLinearization step;
  int k = model_->num_steps();
  for (size_t i : order) {
    if (IsCrowd() && k > intervals[i].end) {
      const Eigen::VectorXd pulled =
          PullBackOver(intervals[i].end, k, Eigen::Map<Eigen::VectorXd>(lambda.data(), lambda.size()));
      lambda.assign(pulled.begin(), pulled.end());
      k = intervals[i].end;
    }
    for (; k > intervals[i].end; --k) {
      model_->ExpandForce(control_, k - 1, u);
      model_->Linearize(StateAt(k - 1), u, /*with_parameters=*/false, &step);
      step.ApplyTranspose(lambda, before, unused);
      std::swap(lambda, before);
    }
    costates_[i] = Eigen::Map<Eigen::VectorXd>(lambda.data(), lambda.size());
  }
}

// How often each pair meets; a contact counts once as long as it lasts. Their order is not compared: several may fall
// into one step.
std::string Attributor::CompareSequences(const std::vector<Interval>& intervals) const {
  if (intervals.size() >= Attribution::kMostContacts) return "";
  std::vector<std::string> pairs;  // in the order of their first exact contact, then of the model's
  std::map<std::string, int> own, exact;
  const auto count = [&](const Candidate& pair, std::map<std::string, int>* counts) {
    const std::string name = PairName(pair);
    if (own[name] + exact[name] == 0) pairs.push_back(name);
    ++(*counts)[name];
  };
  const std::unique_ptr<Simulator> reference = Simulate(exact_contact_, scene_);
  if (!reference->Rollout(initial_, InitialControl(scene_, reference->num_steps()))) return "";
  for (const StepTouch& at : reference->touches()) {
    if (at.touch.kind == ContactKind::kImpact) count(at.touch.candidate, &exact);
  }
  for (const Interval& interval : intervals) {
    for (const Meeting& meeting : interval.meetings) count(meeting.pair, &own);
  }
  for (const std::string& pair : pairs) {
    if (own[pair] == exact[pair]) continue;
    return pair + " meet " + std::to_string(own[pair]) + " times, not " + std::to_string(exact[pair]);
  }
  return "";
}

// The first ones, all unless it is stopped. They are begun in their order, so that few are lost then.
std::vector<ContactError> Attributor::CompareAll(const std::vector<Interval>& intervals) const {
  const auto stopped = [&] { return stop_ && stop_(); };
  std::vector<std::optional<ContactError>> found(intervals.size());
  std::atomic<std::size_t> next = 0;
  std::mutex saying;
  ParallelFor(threads_, threads_, [&](int, int) {
    for (std::size_t i = next++; i < intervals.size() && !stopped(); i = next++) {
      if (status_) {
        const std::lock_guard lock(saying);
        status_("contact " + std::to_string(i + 1) + " of " + std::to_string(intervals.size()) + " at " +
                std::to_string(model_->num_steps()) + " steps");
      }
      ContactError error = Compare(intervals[i], costates_[i]);
      if (!stopped()) found[i] = std::move(error);
    }
  });
  std::vector<ContactError> errors;
  for (std::size_t i = 0; i < found.size() && found[i]; ++i) errors.push_back(std::move(*found[i]));
  return errors;
}

Attribution Attributor::Run() {
  Attribution out;
  for (const ModelTraits& traits : AllContactModels()) {
    if (traits.event_driven && WhyNotApplicable(traits.name, scene_).empty()) exact_contact_ = traits.name;
  }
  if (exact_contact_.empty()) {
    out.reason = "there is no exact flow";
    return out;
  }
  initial_ = InitialState(scene_);
  control_ = InitialControl(scene_, model_->num_steps());
  const auto stopped = [&] { return stop_ && stop_(); };
  if (!model_->Rollout(initial_, control_)) {
    if (stopped()) {
      out.limit = "no contacts";
      return out;
    }
    out.reason = "the rollout fails: " + model_->WhyFailed();
    return out;
  }
  const std::vector<Interval> intervals = FindIntervals();
  if (!stopped()) FindCostates(intervals);
  if (!stopped()) out.contacts = CompareAll(intervals);
  if (out.contacts.size() == intervals.size()) {
    out.sequence = CompareSequences(intervals);
  } else {
    out.limit = std::to_string(out.contacts.size()) + " of " + std::to_string(intervals.size()) + " contacts";
  }
  return out;
}

}  // namespace internal

using internal::Attributor, internal::kSmallError;

namespace {

// An error stays if more steps leave this part of it: at least eight times as many, so that one of first order would
// fall to an eighth, and about as many as make causes clear.
constexpr int kRefinement = 8, kMostRefinement = 256;
constexpr int kClearSteps = 2000;
constexpr double kStays = 0.25;

std::string Seconds(double seconds) {
  char text[32];
  std::snprintf(text, sizeof text, "%.3g s", seconds);
  return text;
}

}  // namespace

const char* BlockToString(Block block) {
  switch (block) {
    case Block::kPositionFromPosition:
      return "position from position";
    case Block::kVelocityFromPosition:
      return "velocity from position";
    case Block::kPositionFromVelocity:
      return "position from velocity";
    case Block::kVelocityFromVelocity:
      return "velocity from velocity";
  }
  LOG(FATAL) << "no such block";
}

Attribution AttributeError(const Contact& contact, const Scene& given, const AttributionOptions& options) {
  CHECK_GE(options.seconds, 0);
  CHECK_GT(options.threads, 0);
  Attribution refused;
  refused.reason = WhyNotApplicable(contact, given);
  if (!refused.ok()) return refused;
  const Scene scene = InNaturalUnits(given);
  const StopRequest end = StopAfter(options.seconds, options.stop);
  const StopRequest half = StopAfter(options.seconds / 2, options.stop);
  Attribution own = Attributor(contact, scene, half, options.status, options.threads).Run();
  const std::string after = " compared in " + Seconds(options.seconds);
  if (!own.limit.empty()) own.limit += after;
  if (!own.ok() || own.contacts.empty()) return own;
  // Not quite a multiple, so that an impact on a grid node is not on one again.
  Scene refined = scene;
  refined.steps = std::clamp(kClearSteps / scene.steps, kRefinement, kMostRefinement) * scene.steps +
                  CHECK_NOTNULL(FindContactModel(contact))->grid_steps;
  const Attribution fine = Attributor(contact, refined, end, options.status, options.threads).Run();
  if (!fine.limit.empty()) {
    own.limit += (own.limit.empty() ? "" : "; ") + fine.limit + " with more steps" + after;
  }
  for (size_t i = 0; i < own.contacts.size(); ++i) {
    ContactError& error = own.contacts[i];
    const ContactError* same = i < fine.contacts.size() ? &fine.contacts[i] : nullptr;
    if (same != nullptr && (same->a != error.a || same->b != error.b)) same = nullptr;
    const bool cut = same == nullptr && !fine.limit.empty();  // then the steps may be to blame, or not
    error.stays = error.error > kSmallError && !cut && (same == nullptr || same->error > kStays * error.error);
    // An impulse, whose closed form is that of a point in time, is judged by the smallest steps; a force that acts for
    // a while by the scene's own.
    const ContactError& finest = same != nullptr ? *same : error;
    const bool impulse = finest.first_step == finest.last_step;
    if (impulse && !finest.why.empty()) error.why = finest.why;
    if (!impulse && error.first_step == error.last_step) error.why = "contact force not resolved by its single step";
    if (!error.stays && impulse) error.why.clear();
    if (own.first_wrong < 0 && error.error > kSmallError && (error.stays || !impulse)) {
      own.first_wrong = static_cast<int>(i);
    }
  }
  return own;
}

}  // namespace saltus
