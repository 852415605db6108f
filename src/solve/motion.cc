#include "solve/motion.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <memory>
#include <numeric>
#include <tuple>

#include "saltus/control/contact_sequence.h"
#include "saltus/simulate/events.h"
#include "saltus/simulate/exact_run.h"
#include "scene/path_motion.h"
#include "scene/units.h"
#include "solve/control_guess.h"

namespace saltus {

// ---- Exact motion over part of a step

namespace {

// The scene with the discs at hand only: what touches, and nothing to optimise.
Scene PartOf(const Scene& scene, const std::vector<int>& discs) {
  Scene part = scene;
  part.bodies.clear();
  part.control = {};
  part.objective = {};
  part.optimize = Optimize::kNone;
  part.free.clear();
  part.free_spin.clear();
  part.no_contact.clear();
  part.steps = 1;
  std::vector<int> place(scene.bodies.size(), -1);
  for (const int disc : discs) {
    place[disc] = part.num_bodies();
    part.bodies.push_back(scene.bodies[disc]);
  }
  for (const NoContact& pair : scene.no_contact) {
    const int a = place[pair.a], b = pair.plane ? pair.b : place[pair.b];
    if (a >= 0 && b >= 0) part.no_contact.push_back({a, b, pair.plane});
  }
  return part;
}

// Simulates only the discs that touch something, and lets all others fly: of a thousand discs few meet in a step. Discs
// that do not touch do not change each other's motion, so that states are those of the whole scene.
class ExactFlight {
 public:
  // The exact model takes `scene`, which is in its natural units and outlives the object.
  explicit ExactFlight(const Scene& scene) : scene_(scene), integrates_(!NonBallisticForces(scene).empty()) {}

  // Sets which discs touch anything in the flights that follow; all others must not.
  void SetTouching(const std::vector<char>& touches) {
    discs_.clear();
    for (int i = 0; i < scene_.num_bodies(); ++i) {
      if (touches[i] || integrates_) discs_.push_back(i);
    }
    part_ = PartOf(scene_, discs_);
  }

  // The state (simulator.h) after `time` from state x at time `begin` under `force` (B x 2, on every disc). That is x
  // if the time is too short for numbers; not a number where the simulation fails.
  std::vector<double> Fly(std::span<const double> x, std::span<const double> force, double begin, double time) const {
    Scene part = ShiftTimeOrigin(part_, begin);
    part.duration = time;
    std::vector<double> next(x.begin(), x.end());
    if (!ReasonNotApplicable(model_, part).empty()) return next;
    const std::unique_ptr<Simulator> simulator = MakeSimulator(model_, part, Precision::kDouble);
    const std::size_t size = simulator->body_size();
    std::vector<double> from, pushes;
    for (const int disc : discs_) {
      from.insert(from.end(), &x[disc * size], &x[disc * size] + size);
      pushes.insert(pushes.end(), &force[2 * disc], &force[2 * disc] + 2);
    }
    std::vector<double> to(from.size());
    simulator->Step(from, pushes, to);
    for (int i = 0, flown = 0; i < scene_.num_bodies(); ++i) {
      const std::span<double> state = std::span(next).subspan(i * size, size);
      if (flown < part.num_bodies() && discs_[flown] == i) {
        std::ranges::copy(std::span(to).subspan(flown++ * size, size), state.begin());
      } else {
        FlyFreely(i, force, time, state);
      }
    }
    return next;
  }

  // Returns the state just before an event at the end of `time`. A flight that is integrated ends behind its event: it
  // is taken to `margin` before the event, and goes on with the velocity there.
  std::vector<double> FlyToEvent(std::span<const double> x, std::span<const double> force, double begin, double time,
                                 double margin) const {
    if (!integrates_) return Fly(x, force, begin, time);
    std::vector<double> before = Fly(x, force, begin, time - margin);
    const std::size_t size = before.size() / scene_.bodies.size();
    for (std::size_t i = 0; i < before.size(); i += size) {
      for (std::size_t j = i; j < i + 2; ++j) before[j] += margin * before[j + 2];
    }
    return before;
  }

 private:
  void FlyFreely(int disc, std::span<const double> force, double time, std::span<double> state) const {
    const Body& body = scene_.bodies[disc];
    if (body.fixed) return;
    for (int j = 0; j < 2; ++j) {
      const double acceleration = force[2 * disc + j] * (1 / body.mass) + scene_.gravity[j];
      state[j] += time * (state[2 + j] + (0.5 * time) * acceleration);
      state[2 + j] += time * acceleration;
    }
    if (state.size() > 4) state[4] += time * state[5];
  }

  const Contact model_{ExactModel()->name};
  const Scene& scene_;
  const bool integrates_;   // whether all discs are moved together, as flights have no constant acceleration
  Scene part_;              // has the discs that touch
  std::vector<int> discs_;  // these
};

// ---- Motions

constexpr double kJustAfter = 1e-6;   // of a step: when velocities after an impact are looked at
constexpr double kOneInstant = 1e-9;  // of a step, or of the whole: what is nearer to each other is drawn as one

using ContactKey = std::tuple<bool, int, int>;
ContactKey KeyOf(const Candidate& c) { return {c.plane, c.a, c.b}; }

// Returns the momentum that disc a (or, if it is fixed, what b gives to it) gains from state x to state y beyond that
// of `forces` over `time`.
Vec2d ImpulseOn(const Scene& scene, const Candidate& c, std::span<const double> x, std::span<const double> y,
                int body_size, std::span<const double> forces, double time) {
  const bool mirrored = scene.bodies[c.a].fixed && !c.plane;
  const int i = mirrored ? c.b : c.a;
  const Body& body = scene.bodies[i];
  if (body.fixed) return Vec2d::Zero();
  Vec2d gain = Vec2d::Zero();
  for (int j = 0; j < 2; ++j) {
    const double velocity = y[i * body_size + 2 + j] - x[i * body_size + 2 + j];
    gain[j] = body.mass * velocity - time * (forces[2 * i + j] + body.mass * scene.gravity[j]);
  }
  return mirrored ? Vec2d(-gain) : gain;
}

// One simulator's rollout, its states one after the other, up to where it fails.
class Way {
 public:
  Way(const Contact& contact, const Scene& scene, Precision precision, std::span<const double> initial,
      std::span<const double> control, const MotionOptions& options)
      : simulator_(MakeSimulator(contact, scene, precision)), control_(control) {
    simulator_->set_memory_limit(std::max(options.most_bytes / 2, simulator_->LeastMemory()));
    simulator_->set_stop(options.stop);
    ok_ = simulator_->Rollout(initial, control);
    x_.resize(simulator_->state_size());
    next_ = x_;
    force_.resize(simulator_->force_size());
    if (ok_) {
      simulator_->GetState(0, x_);
    } else {
      simulator_->ExpandInitial(initial, x_);
    }
  }

  const Simulator& simulator() const { return *simulator_; }
  int num_steps() const { return simulator_->num_steps(); }
  int step() const { return step_; }
  // The states before and after the current step, and the force on every disc during it.
  std::span<const double> x() const { return x_; }
  std::span<const double> next() const { return next_; }
  std::span<const double> force() const { return force_; }
  std::string FailureReason() const { return simulator_->stopped() ? kStopped : simulator_->FailureReason(); }

  // Takes step k = 0, 1, ...; false where the rollout fails or is stopped.
  bool Take(int k) {
    if (k > 0) x_.swap(next_);
    step_ = k;
    simulator_->ExpandForce(control_, k, force_);
    if (ok_) {
      simulator_->GetState(k + 1, next_);
    } else if (simulator_->scene().HasPaths()) {
      return false;  // a step by itself begins at time 0
    } else {
      simulator_->Step(x_, force_, next_);
    }
    if (simulator_->stopped()) return false;  // a state that was asked for may be none
    return std::ranges::all_of(next_, [](double value) { return std::isfinite(value); });
  }

 private:
  std::unique_ptr<Simulator> simulator_;
  std::span<const double> control_;
  bool ok_ = false;
  int step_ = 0;
  std::vector<double> x_, next_, force_;
};

// Collects states, as many as the options allow.
class Recorder {
 public:
  Recorder(const Scene& scene, const MotionOptions& options, size_t nodes, Motion* motion)
      : bodies_(scene.bodies.size()),
        spins_(scene.Spins()),
        stride_((nodes + options.most_nodes - 1) / options.most_nodes),
        motion_(motion) {
    const size_t kept = nodes / stride_ + 2, each = bodies_ * (spins_ ? 4 + kSpin : 4) * sizeof(double);
    instants_left_ = options.most_nodes > kept ? (options.most_nodes - kept) / 2 : 0;
    instants_left_ = std::min(instants_left_, (options.most_bytes / each) / 2);
    if (kept > options.most_bytes / each) {
      motion->failure = "its states take " + std::to_string(kept * each >> 20) + " MiB, more than the limit of " +
                        std::to_string(options.most_bytes >> 20) + " MiB";
    }
  }

  bool whole() const { return stride_ == 1; }
  // Makes room for so many nodes, and for two states at each event.
  void Reserve(size_t nodes, size_t events) {
    const size_t rows = motion_->times.size() + nodes / stride_ + 2 + 2 * std::min(events, instants_left_ / 2);
    motion_->times.reserve(rows);
    motion_->states.reserve(4 * bodies_ * rows);
    if (spins_) motion_->rotations.reserve(kSpin * bodies_ * rows);
  }

  bool TakesInstants(size_t count) {
    if (instants_left_ < count) return false;
    instants_left_ -= count;
    return true;
  }

  void Add(double time, std::span<const double> x, int body_size) {
    motion_->times.push_back(time);
    for (size_t i = 0; i < bodies_; ++i) {
      const auto body = x.begin() + static_cast<std::ptrdiff_t>(i) * body_size;
      motion_->states.insert(motion_->states.end(), body, body + 4);
      if (spins_) motion_->rotations.insert(motion_->rotations.end(), body + 4, body + 4 + kSpin);
    }
  }
  void AddNode(double time, std::span<const double> x, int body_size, bool last = false) {
    if (number_++ % stride_ == 0 || last) Add(time, x, body_size);
  }

 private:
  size_t bodies_;
  bool spins_;
  size_t stride_, instants_left_ = 0, number_ = 0;
  Motion* motion_;
};

// Joins the touches of a pair in consecutive steps.
class TouchCollector {
 public:
  TouchCollector(Motion* motion, double margin) : motion_(motion), margin_(margin) {}

  void Add(const Candidate& c, double begin, double end, const Vec2d& impulse) {
    const auto [at, is_new] = last_.try_emplace(KeyOf(c), motion_->touches.size());
    if (!is_new) {
      TouchSpan& span = motion_->touches[at->second];
      if (begin <= span.end + margin_ && end > span.end) {
        span.end = end;
        span.impulse += impulse;
        return;
      }
      if (end <= span.end && begin < end) return;  // reported twice in a step
      at->second = motion_->touches.size();
    }
    motion_->touches.push_back({c, begin, end, impulse});
  }

 private:
  Motion* motion_;
  double margin_;
  std::map<ContactKey, size_t> last_;
};

void SortTouches(Motion* motion) { std::ranges::stable_sort(motion->touches, {}, &TouchSpan::begin); }

// A group of consecutive intervals of equal length.
struct Group {
  int first = 0, count = 0;
  double length = 0;
};
std::vector<Group> GroupsOf(const std::vector<double>& lengths) {
  std::vector<Group> groups;
  for (size_t k = 0; k < lengths.size(); ++k) {
    if (groups.empty() || groups.back().length != lengths[k]) groups.push_back({static_cast<int>(k), 0, lengths[k]});
    ++groups.back().count;
  }
  std::erase_if(groups, [](const Group& group) { return group.length == 0; });
  return groups;
}

// The exact motion of a scene in its natural units.
class ExactMotion {
 public:
  ExactMotion(const Scene& scene, const MotionOptions& options, size_t nodes)
      : scene_(scene),
        options_(options),
        size_(InitialSize(scene) / scene.num_bodies()),
        flight_(scene),
        recorder_(scene, options, nodes, &motion_),
        touches_(&motion_, kOneInstant * scene.duration) {
    motion_.arcs = recorder_.whole();
  }

  Motion Run(std::vector<double> x, const std::vector<double>& control, const std::vector<double>& lengths) {
    const size_t width = scene_.control_width();
    if (motion_.failure.empty()) recorder_.AddNode(0, ToState(x, scene_.num_bodies()), size_);
    for (const Group& group : GroupsOf(lengths)) {
      if (!motion_.failure.empty()) break;
      Scene part = ShiftTimeOrigin(scene_, start_);
      part.steps = group.count;
      part.duration = group.count * group.length;
      const std::span<const double> rows(control.data() + width * group.first, width * group.count);
      RunGroup(part, rows, &x);
    }
    SortTouches(&motion_);
    return std::move(motion_);
  }

 private:
  void RunGroup(const Scene& part, std::span<const double> rows, std::vector<double>* x) {
    motion_.failure = ReasonNotApplicable(ExactModel()->name, part);
    if (!motion_.failure.empty()) return;
    Way way(ExactModel()->name, part, Precision::kDouble, *x, rows, options_);
    const double h = way.simulator().step();
    const std::vector<StepTouch>& touches = way.simulator().touches();
    const std::vector<StepTouch> events = EventTouches(way.simulator());
    recorder_.Reserve(way.num_steps(), events.size());
    auto touch = touches.begin();
    auto event = events.begin();
    for (int k = 0; k < way.num_steps(); ++k) {
      if (!way.Take(k)) {
        motion_.failure = way.FailureReason();
        return;
      }
      std::vector<StepTouch> here;
      for (; event != events.end() && event->step == k; ++event) here.push_back(*event);
      if (!here.empty()) AddInstants(way, here, Touching(touch, touches.end()), h);
      for (; touch != touches.end() && touch->step == k; ++touch) Extend(*touch, k * h, h);
      recorder_.AddNode(start_ + (k + 1) * h, way.next(), size_, k + 1 == way.num_steps());
    }
    start_ += way.num_steps() * h;
    *x = ToInitial(way.next(), scene_.num_bodies());
  }

  using Touches = std::vector<StepTouch>::const_iterator;

  // Returns which discs touch anything in the step of the first touch, or in the next, into which flights may reach.
  std::vector<char> Touching(Touches touch, Touches end) const {
    std::vector<char> touching(scene_.bodies.size());
    for (const int step = touch->step; touch != end && touch->step <= step + 1; ++touch) {
      const Candidate& c = touch->touch.candidate;
      touching[c.a] = 1;
      if (!c.plane) touching[c.b] = 1;
    }
    return touching;
  }

  // The states before and after each event of a step: from the last one flown, or begun with, once more.
  void AddInstants(const Way& way, const std::vector<StepTouch>& events, const std::vector<char>& touching, double h) {
    if (!recorder_.TakesInstants(2 * events.size())) {
      motion_.arcs = false;
      for (const StepTouch& at : events) Report(at, start_ + way.step() * h, Vec2d::Zero());
      return;
    }
    flight_.SetTouching(touching);
    std::vector<double> before(way.x().begin(), way.x().end());
    const double begin = start_ + way.step() * h;
    double now = 0;
    for (size_t i = 0, end = 0; i < events.size(); i = end) {
      const double time = events[i].touch.time, instant = begin + time;
      while (end < events.size() && events[end].touch.time - time <= kOneInstant * h) ++end;
      if (time - now > kOneInstant * h) {
        // The remainder at the end of the flight (time_grid.h) is added to the next flight.
        before = flight_.FlyToEvent(before, way.force(), begin + now, time - now, 0.5 * kOneInstant * h);
        recorder_.Add(instant, before, size_);
        now = time;
      }
      std::vector<double> after = flight_.Fly(before, way.force(), instant, kJustAfter * h);
      for (size_t j = 0; j < after.size(); j += size_) std::copy_n(before.begin() + j, 2, after.begin() + j);
      recorder_.Add(instant, after, size_);
      for (size_t j = i; j < end; ++j) {
        Report(events[j],
               begin,
               ImpulseOn(scene_, events[j].touch.candidate, before, after, size_, way.force(), kJustAfter * h));
      }
    }
  }

  void Report(const StepTouch& at, double step_start, const Vec2d& impulse) {
    const double time = step_start + at.touch.time;
    if (at.touch.kind == ContactKind::kSustained) {
      touches_.Add(at.touch.candidate, time, time, impulse);
    } else {
      motion_.touches.push_back({at.touch.candidate, time, time, impulse});
    }
  }

  // Extends contacts with a force to the end of the step.
  void Extend(const StepTouch& at, double step_start, double h) {
    if (at.touch.kind != ContactKind::kSustained) return;
    const double begin = start_ + step_start;
    touches_.Add(at.touch.candidate, begin, begin + h, Vec2d::Zero());
  }

  const Scene& scene_;
  const MotionOptions& options_;
  Motion motion_;
  int size_;  // of a body's state
  ExactFlight flight_;
  Recorder recorder_;
  TouchCollector touches_;
  double start_ = 0;  // s, of the group
};

Motion ConvertMotion(Motion motion, const Units& from, const Units& to) {
  const UnitFactors by(from, to);
  motion.states = ConvertStates(std::move(motion.states), from, to);
  for (size_t i = 1; i < motion.rotations.size(); i += kSpin) motion.rotations[i] *= by.rate;
  for (double& time : motion.times) time *= by.time;
  for (TouchSpan& touch : motion.touches) {
    touch.begin *= by.time;
    touch.end *= by.time;
    touch.impulse *= by.mass * by.speed;
  }
  return motion;
}

Motion Refuse(const std::string& reason) {
  Motion motion;
  motion.failure = reason;
  return motion;
}

}  // namespace

Scene FixFinalTime(Scene scene, const MotionInput& input, double* price) {
  scene.free.clear();
  scene.optimize = scene.num_controlled() > 0 ? Optimize::kControl : Optimize::kNone;
  if (!scene.objective.duration) return scene;
  scene.duration = DurationOf({input.control, input.durations}, scene);
  *price = scene.objective.duration->weight * scene.duration;
  scene.objective.duration.reset();
  return scene;
}

Motion SimulateExactMotion(const Scene& given, const MotionInput& input, const MotionOptions& options) {
  if (const std::string reason = ReasonNotApplicable(ExactModel()->name, given); !reason.empty()) return Refuse(reason);
  const Scene scene = ToNaturalUnits(given);
  const UnitFactors to(given.units, scene.units);
  std::vector<double> lengths(scene.steps, scene.dt());
  if (scene.num_controlled() > 0) {
    const ControlGuess guess{{input.control}, Multiplied(input.durations, to.time)};
    lengths = LengthsOf(guess, scene);
  } else if (!input.durations.empty()) {
    lengths = Multiplied(input.durations, to.time);
  }
  ExactMotion exact(scene, options, lengths.size() + 1);
  Motion motion = exact.Run(ConvertInitial(input.initial, scene.num_bodies(), given.units, scene.units),
                            Multiplied(input.control, to.force),
                            lengths);
  return ConvertMotion(std::move(motion), scene.units, given.units);
}

Motion SimulateMotion(const Scene& given, const Contact& contact, const MotionInput& input,
                      const MotionOptions& options) {
  Scene scene = given;
  if (!input.durations.empty()) {
    scene.duration = std::accumulate(input.durations.begin(), input.durations.end(), 0.0);
  }
  if (const std::string reason = ReasonNotApplicable(contact, scene); !reason.empty()) return Refuse(reason);
  if (contact.entry()->traits.event_driven) return SimulateExactMotion(given, input, options);
  const int steps = scene.steps / contact.entry()->traits.grid_steps;
  std::vector<double> control = input.control;
  if (!control.empty()) control = MeanOverSteps({control, input.durations}, scene.control_width(), steps);

  Motion motion;
  Recorder recorder(scene, options, steps + 1, &motion);
  if (!motion.failure.empty()) return motion;
  Way way(contact, scene, options.precision, input.initial, control, options);
  const int size = way.simulator().body_size();
  const double h = way.simulator().step();
  TouchCollector touches(&motion, 0.5 * h);
  auto touch = way.simulator().touches().begin();
  recorder.AddNode(0, way.x(), size);
  for (int k = 0; k < way.num_steps(); ++k) {
    if (!way.Take(k)) {
      motion.failure = way.FailureReason();
      break;
    }
    for (; touch != way.simulator().touches().end() && touch->step == k; ++touch) {
      const Candidate& c = touch->touch.candidate;
      touches.Add(c, k * h, (k + 1) * h, ImpulseOn(scene, c, way.x(), way.next(), size, way.force(), h));
    }
    recorder.AddNode((k + 1) * h, way.next(), size, k + 1 == way.num_steps());
  }
  SortTouches(&motion);
  return motion;
}

Motion StatesAtNodes(const Motion& motion, const std::vector<double>& nodes) {
  Motion at{.times = nodes, .states = {}, .arcs = false, .touches = motion.touches, .failure = motion.failure};
  if (motion.times.empty()) return at;
  const double margin = 1e-10 * motion.times.back();
  size_t row = 0;
  for (const double time : nodes) {
    while (row + 1 < motion.times.size() && motion.times[row] < time - margin) ++row;
    const auto take = [&](const std::vector<double>& from, std::vector<double>* to) {
      const auto width = static_cast<std::ptrdiff_t>(from.size() / motion.times.size());
      const auto begin = from.begin() + static_cast<std::ptrdiff_t>(row) * width;
      to->insert(to->end(), begin, begin + width);
    };
    take(motion.states, &at.states);
    take(motion.rotations, &at.rotations);
  }
  return at;
}

}  // namespace saltus
