#include "saltus/audit/attribution.h"

#include <glog/logging.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <map>
#include <memory>
#include <numeric>
#include <optional>
#include <utility>

#include "audit/impact_faults.h"
#include "audit/step_map.h"
#include "physics/units.h"
#include "saltus/control/objective.h"
#include "saltus/dynamics/registry.h"
#include "saltus/physics/geometry.h"
#include "saltus/physics/walls.h"

namespace saltus {
namespace {

constexpr double kTouching = 1e-11;  // overlap that is none
constexpr int kLongest = 1024;       // steps of one interval; a contact that lasts longer is cut
constexpr int kMargin = 2;           // steps by which an interval may grow to find the exact impact
// How much smaller steps are when asking whether a force is resolved, at most and at least.
constexpr int kFiner = 32, kLeastFiner = 4;
constexpr int kMostFineSteps = 8192;
constexpr double kSmallError = 1e-3;
// An error stays if more steps leave this part of it: at least eight times as many, so that one of first order would
// fall to an eighth, and about as many as make causes clear.
constexpr int kRefinement = 8, kMostRefinement = 256;
constexpr int kClearSteps = 2000;
constexpr double kStays = 0.25;

// A pair, and the first and last step in which the model lets it touch.
struct Meeting {
  Candidate pair;
  int first = 0, last = 0;
};

// Steps [begin, end) of the model, and the pairs that meet in them: connected by discs that move, so that other discs
// may meet in the same steps without being part of it.
struct Interval {
  int begin = 0, end = 0;
  std::vector<Meeting> meetings;

  int first_touch() const {
    int first = meetings.front().first;
    for (const Meeting& meeting : meetings) first = std::min(first, meeting.first);
    return first;
  }
  int last_touch() const {
    int last = 0;
    for (const Meeting& meeting : meetings) last = std::max(last, meeting.last);
    return last;
  }
  // Steps of the longest meeting.
  int longest() const {
    int steps = 0;
    for (const Meeting& meeting : meetings) steps = std::max(steps, meeting.last - meeting.first + 1);
    return steps;
  }
};

class Attributor {
 public:
  Attributor(const Contact& contact, const Scene& scene, const StopRequest& stop)
      : contact_(contact), scene_(scene), walls_(WallPartsOf(scene)), stop_(stop), model_(Simulate(contact, scene)) {}

  Attribution Run();

 private:
  const Simulator& model() const { return *model_; }
  double h() const { return model_->step(); }
  std::unique_ptr<Simulator> Simulate(const Contact& contact, const Scene& scene) const {
    std::unique_ptr<Simulator> simulator = MakeSimulator(contact, scene, Precision::kDouble);
    simulator->set_stop(stop_);
    return simulator;
  }

  std::vector<double> StateAt(int k) const {
    std::vector<double> x(model_->state_size());
    model_->GetState(k, x);
    return x;
  }
  // Position and velocity only.
  std::vector<double> PlainStateAt(int k) const {
    const std::vector<double> x = StateAt(k);
    std::vector<double> plain;
    for (int i = 0; i < model_->num_bodies(); ++i) {
      plain.insert(plain.end(), x.begin() + i * model_->body_size(), x.begin() + i * model_->body_size() + 4);
    }
    return plain;
  }
  ForceOfStep ForcesFrom(int begin, int finer = 1) const {
    return [this, begin, finer](int k, std::span<double> force) {
      model_->ExpandForce(control_, begin + k / finer, force);
    };
  }
  // The model `contact` over the time of an interval, cut into `steps` of its own steps.
  std::unique_ptr<Simulator> SimulatorOf(const Contact& contact, const Interval& interval, int steps) const {
    Scene scene = scene_;
    scene.duration = (interval.end - interval.begin) * h();
    scene.steps = steps * CHECK_NOTNULL(FindContactModel(contact))->grid_steps;
    return Simulate(contact, scene);
  }

  std::vector<Interval> FindIntervals() const;
  void AddTouch(const StepTouch& at, std::vector<Interval>* intervals) const;
  bool Overlap(const Interval& interval, int k) const;
  bool Involves(const Interval& interval, const Candidate& pair) const;
  bool HasExactImpact(const Interval& interval) const;
  StepMap ExactOver(const Interval& interval, const std::vector<int>* bodies) const;
  void FindCostates(const std::vector<Interval>& intervals);
  ContactError Compare(const Interval& interval, const Eigen::VectorXd& costate) const;
  std::string Why(const Interval& interval, const StepMap& exact, const StepMap& approximate,
                  const std::vector<int>& bodies) const;
  std::optional<PairImpact> OnlyImpact(const Interval& interval, const StepMap& exact) const;
  std::string WhyUnresolved(const Interval& interval, const StepMap& exact, const StepMap& approximate,
                            const std::vector<int>& bodies) const;
  // Drops touches that no chain of touches connects with the interval; collects the discs that move of the others.
  void KeepConnected(Interval interval, std::vector<StepTouch>* exact, std::vector<StepTouch>* own,
                     std::vector<int>* bodies) const;
  double Norm(const Eigen::VectorXd& costate) const;
  std::string PairName(const Candidate& pair) const;
  std::string CompareSequences(const std::vector<Interval>& intervals) const;

  Contact contact_;
  Scene scene_;
  std::vector<WallPart> walls_;
  const StopRequest& stop_;
  std::unique_ptr<Simulator> model_;
  std::string exact_contact_;
  std::vector<double> initial_, control_;
  std::vector<Eigen::VectorXd> costates_;  // at the end of each interval
};

double Attributor::Norm(const Eigen::VectorXd& costate) const {
  double sum = 0;
  for (int i = 0; i < costate.size(); ++i) {
    const double entry = costate[i] / (i % 4 < 2 ? 1.0 : scene_.duration);
    sum += entry * entry;
  }
  return std::sqrt(sum);
}

std::string Attributor::PairName(const Candidate& pair) const {
  return scene_.bodies[pair.a].name + " - " + (pair.plane ? walls_[pair.b].name : scene_.bodies[pair.b].name);
}

bool Attributor::Overlap(const Interval& interval, int k) const {
  const std::vector<double> x = PlainStateAt(k);
  const auto position = [&](int i) { return Vec2d(x[4 * i], x[4 * i + 1]); };
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
  const std::vector<StepTouch> touches = ExactOver(interval, nullptr).touches;
  return std::any_of(
      touches.begin(), touches.end(), [&](const StepTouch& at) { return Involves(interval, at.touch.candidate); });
}

StepMap Attributor::ExactOver(const Interval& interval, const std::vector<int>* bodies) const {
  const int steps = interval.end - interval.begin;
  const std::unique_ptr<Simulator> exact = SimulatorOf(exact_contact_, interval, steps);
  const std::vector<double> begin = PlainStateAt(interval.begin);
  if (bodies == nullptr) return RunSteps(*exact, begin, ForcesFrom(interval.begin), steps);
  return ComposeSteps(*exact, begin, ForcesFrom(interval.begin), steps, *bodies);
}

// One sweep of the model's own adjoint from the end.
void Attributor::FindCostates(const std::vector<Interval>& intervals) {
  std::vector<double> lambda(model_->state_size()), before(lambda.size()), u(2 * model_->num_bodies());
  std::vector<double> unused(u.size());
  TerminalGradient(scene_.objective, StateAt(model_->num_steps()), model_->body_size(), lambda);
  costates_.resize(intervals.size());
  std::vector<size_t> order(intervals.size());
  std::iota(order.begin(), order.end(), size_t{0});
  std::sort(order.begin(), order.end(), [&](size_t a, size_t b) { return intervals[a].end > intervals[b].end; });
  StepLinearization step;
  int k = model_->num_steps();
  for (size_t i : order) {
    for (; k > intervals[i].end; --k) {
      model_->ExpandForce(control_, k - 1, u);
      model_->Linearize(StateAt(k - 1), u, /*with_parameters=*/false, &step);
      step.ApplyTranspose(lambda, before, unused);
      std::swap(lambda, before);
    }
    costates_[i] = Eigen::Map<Eigen::VectorXd>(lambda.data(), lambda.size());
  }
}

void Attributor::KeepConnected(Interval interval, std::vector<StepTouch>* exact, std::vector<StepTouch>* own,
                               std::vector<int>* bodies) const {
  const auto involved = [&](const StepTouch& at) { return Involves(interval, at.touch.candidate); };
  for (bool grown = true; grown;) {
    grown = false;
    for (const std::vector<StepTouch>* touches : {exact, own}) {
      for (const StepTouch& at : *touches) {
        const bool known = std::any_of(interval.meetings.begin(), interval.meetings.end(), [&](const Meeting& meeting) {
          return meeting.pair == at.touch.candidate;
        });
        if (known || !involved(at)) continue;
        interval.meetings.push_back({at.touch.candidate, at.step, at.step});
        grown = true;
      }
    }
  }
  std::erase_if(*exact, std::not_fn(involved));
  std::erase_if(*own, std::not_fn(involved));
  for (const Meeting& meeting : interval.meetings) {
    bodies->push_back(meeting.pair.a);
    if (!meeting.pair.plane) bodies->push_back(meeting.pair.b);
  }
  std::sort(bodies->begin(), bodies->end());
  bodies->erase(std::unique(bodies->begin(), bodies->end()), bodies->end());
  std::erase_if(*bodies, [&](int body) { return scene_.bodies[body].fixed; });
}

ContactError Attributor::Compare(const Interval& interval, const Eigen::VectorXd& costate) const {
  ContactError error;
  error.first_step = interval.first_touch();
  error.last_step = interval.last_touch();
  const auto first = std::find_if(interval.meetings.begin(), interval.meetings.end(), [&](const Meeting& meeting) {
    return meeting.first == error.first_step;
  });
  error.a = scene_.bodies[first->pair.a].name;
  error.b = first->pair.plane ? walls_[first->pair.b].name : scene_.bodies[first->pair.b].name;

  const std::vector<double> begin = StateAt(interval.begin);
  const int steps = interval.end - interval.begin;
  std::vector<StepTouch> own = RunSteps(model(), begin, ForcesFrom(interval.begin), steps).touches;
  std::vector<StepTouch> exact_touches = ExactOver(interval, nullptr).touches;
  std::vector<int> bodies;
  KeepConnected(interval, &exact_touches, &own, &bodies);
  StepMap exact = ExactOver(interval, &bodies);
  exact.touches = exact_touches;
  const StepMap approximate = ComposeSteps(model(), begin, ForcesFrom(interval.begin), steps, bodies);
  error.exact_impacts = static_cast<int>(exact.touches.size());

  const int n = static_cast<int>(bodies.size());
  Eigen::VectorXd lambda(4 * n);
  for (int i = 0; i < n; ++i) lambda.segment<4>(4 * i) = costate.segment<4>(bodies[i] * model().body_size());
  const Eigen::MatrixXd difference = approximate.A - exact.A;
  const double scale = std::max(Norm(exact.A.transpose() * lambda), 1e-300);
  error.error = Norm(difference.transpose() * lambda) / scale;

  double largest = -1;
  for (const Block block : {Block::kPositionFromPosition,
                            Block::kVelocityFromPosition,
                            Block::kPositionFromVelocity,
                            Block::kVelocityFromVelocity}) {
    const bool to_velocity = block == Block::kVelocityFromPosition || block == Block::kVelocityFromVelocity;
    const bool from_velocity = block == Block::kPositionFromVelocity || block == Block::kVelocityFromVelocity;
    Eigen::VectorXd part = Eigen::VectorXd::Zero(4 * n);
    for (int r = 0; r < 4 * n; ++r) {
      if ((r % 4 >= 2) != to_velocity) continue;
      for (int c = 0; c < 4 * n; ++c) {
        if ((c % 4 >= 2) == from_velocity) part[c] += difference(r, c) * lambda[r];
      }
    }
    if (Norm(part) <= largest) continue;
    largest = Norm(part);
    error.block = block;
  }
  if (error.error > kSmallError) error.why = Why(interval, exact, approximate, bodies);
  return error;
}

std::optional<PairImpact> Attributor::OnlyImpact(const Interval& interval, const StepMap& exact) const {
  if (exact.touches.size() != 1 || interval.meetings.size() != 1) return std::nullopt;
  const StepTouch& at = exact.touches.front();
  const Candidate& pair = at.touch.candidate;
  if (at.touch.kind != ContactKind::kImpact || !(pair == interval.meetings.front().pair)) return std::nullopt;

  // The exact state at the begin of the step with the impact, and from there to the impact.
  Interval until = interval;
  until.end = interval.begin + at.step;
  std::vector<double> x = PlainStateAt(interval.begin);
  if (at.step > 0) x = ExactOver(until, nullptr).end;
  std::vector<double> force(2 * model_->num_bodies());
  ForcesFrom(interval.begin)(at.step, force);
  const double time = at.touch.time;
  struct Motion {
    Vec2d p, v, a;
    double inverse_mass;
  };
  const auto motion = [&](int i) -> Motion {
    const Body& body = scene_.bodies[i];
    const Vec2d p(x[4 * i], x[4 * i + 1]), v(x[4 * i + 2], x[4 * i + 3]);
    if (body.fixed) return {p, Vec2d::Zero(), Vec2d::Zero(), 0.0};
    const Vec2d a = Vec2d(force[2 * i], force[2 * i + 1]) / body.mass + scene_.gravity;
    return {p + time * (v + 0.5 * time * a), v + time * a, a, 1 / body.mass};
  };
  const Motion a = motion(pair.a);
  PairImpact impact;
  impact.inverse_mass_a = a.inverse_mass;
  impact.velocity_a = a.v;
  impact.acceleration_a = a.a;
  impact.velocity_b = impact.acceleration_b = Vec2d::Zero();
  if (pair.plane) {
    const Wall<double>& wall = walls_[pair.b].wall;
    const Separation<double> at_wall = Separate<double>(a.p, wall);
    impact.normal = at_wall.normal;
    if (wall.curved()) impact.inverse_distance = 1 / (at_wall.distance + wall.side * wall.radius);
  } else {
    const Motion b = motion(pair.b);
    impact.normal = (a.p - b.p).normalized();
    impact.inverse_distance = 1 / (a.p - b.p).norm();
    impact.inverse_mass_b = b.inverse_mass;
    impact.velocity_b = b.v;
    impact.acceleration_b = b.a;
  }
  impact.restitution = scene_.contact.restitution;
  impact.friction = scene_.contact.friction;
  impact.mode = at.touch.mode;
  impact.before = at.step * h() + time;
  impact.after = (interval.end - interval.begin) * h() - impact.before;
  impact.step = h();
  return impact;
}

// The same model over the same interval with far smaller steps.
std::string Attributor::WhyUnresolved(const Interval& interval, const StepMap& exact, const StepMap& approximate,
                                      const std::vector<int>& bodies) const {
  const int lasts = interval.longest();
  const int length = interval.end - interval.begin;
  const int finer = std::clamp(kMostFineSteps / length, kLeastFiner, kFiner);
  const std::unique_ptr<Simulator> fine_model = SimulatorOf(contact_, interval, length * finer);
  const StepMap fine =
      ComposeSteps(*fine_model, StateAt(interval.begin), ForcesFrom(interval.begin, finer), length * finer, bodies);
  const double coarse_error = ScaledNorm(approximate.A - exact.A, scene_.duration);
  const double fine_error = ScaledNorm(fine.A - exact.A, scene_.duration);
  char text[128];
  if (fine_error < 0.5 * coarse_error) {
    std::snprintf(text,
                  sizeof text,
                  "contact force not resolved by its %d steps (%d times as many leave %.0f %% of the error)",
                  lasts,
                  finer,
                  100 * fine_error / coarse_error);
  } else {
    std::snprintf(text,
                  sizeof text,
                  "contact is soft: it lasts %.2g s, and smaller steps do not help",
                  lasts * h() * scene_.units.time);
  }
  return text;
}

std::string Attributor::Why(const Interval& interval, const StepMap& exact, const StepMap& approximate,
                            const std::vector<int>& bodies) const {
  if (exact.touches.empty()) return "touches where the exact motion does not";
  const bool rests = std::any_of(exact.touches.begin(), exact.touches.end(), [](const StepTouch& at) {
    return at.touch.kind == ContactKind::kSustained;
  });
  if (rests || interval.end - interval.begin >= kLongest) return "a contact that lasts";
  if (interval.longest() > 1) return WhyUnresolved(interval, exact, approximate, bodies);
  if (const std::optional<PairImpact> impact = OnlyImpact(interval, exact)) {
    // Bodies are in the order of their indices, and so are the two of a pair.
    if (const std::optional<std::string> fault = RecogniseFault(*impact, approximate.A, scene_.duration)) return *fault;
  }
  if (exact.touches.size() > 1) return std::to_string(exact.touches.size()) + " impacts in one step";
  return "no known cause";
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
  if (!model_->Rollout(initial_, control_)) {
    out.reason = "the rollout fails: " + model_->WhyFailed();
    return out;
  }
  const std::vector<Interval> intervals = FindIntervals();
  FindCostates(intervals);
  for (size_t i = 0; i < intervals.size() && !model_->stopped(); ++i)
    out.contacts.push_back(Compare(intervals[i], costates_[i]));
  out.sequence = CompareSequences(intervals);
  return out;
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

Attribution AttributeError(const Contact& contact, const Scene& given, const StopRequest& stop) {
  Attribution refused;
  refused.reason = WhyNotApplicable(contact, given);
  if (!refused.ok()) return refused;
  const Scene scene = InNaturalUnits(given);
  Attribution own = Attributor(contact, scene, stop).Run();
  if (!own.ok() || own.contacts.empty()) return own;
  // Not quite a multiple, so that an impact on a grid node is not on one again.
  Scene refined = scene;
  refined.steps = std::clamp(kClearSteps / scene.steps, kRefinement, kMostRefinement) * scene.steps +
                  CHECK_NOTNULL(FindContactModel(contact))->grid_steps;
  const Attribution fine = Attributor(contact, refined, stop).Run();
  for (size_t i = 0; i < own.contacts.size(); ++i) {
    ContactError& error = own.contacts[i];
    const ContactError* same = i < fine.contacts.size() ? &fine.contacts[i] : nullptr;
    if (same != nullptr && (same->a != error.a || same->b != error.b)) same = nullptr;
    error.stays = error.error > kSmallError && (same == nullptr || same->error > kStays * error.error);
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
