#include "audit/gradient/events_at_once.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <map>
#include <optional>
#include <set>
#include <utility>

#include "saltus/control/single_shooting.h"
#include "saltus/simulate/events.h"

namespace saltus {
namespace {

constexpr double kSameTime = 1e-9;  // of the duration
// Widths of differences, in natural units; each so much less than the last. Moved along each other by w, two discs meet
// later by w^2, which must be more than rounding: what comes first decides the slope.
constexpr double kWidest = 1e-3, kNarrower = 0.1;
constexpr int kWidths = 3;
constexpr double kTolerance = 1e-5;  // by which an entry may miss its differences, of the largest of its quantity
constexpr double kSmooth = 1e-6;     // likewise, by which extrapolations of differences may differ
constexpr double kMostWork = 1e7;    // entries times discs times steps
constexpr double kPasses = 1e-9;     // gap at which two discs pass each other, of the sum of their radii

bool HasImpactAtOnce(const Simulator& simulator) {
  const Scene& scene = simulator.scene();
  const std::vector<StepTouch> events = EventTouches(simulator);
  const auto time_of = [&](const StepTouch& at) { return at.step * simulator.step() + at.touch.time; };
  const auto share = [&](const Candidate& c, const Candidate& d) {
    const auto has = [&](int i) { return !scene.bodies[i].fixed && (d.a == i || (!d.plane && d.b == i)); };
    return !(c == d) && (has(c.a) || (!c.plane && has(c.b)));
  };
  for (std::size_t k = 0; k < events.size(); ++k) {
    for (std::size_t j = k; j-- > 0 && time_of(events[k]) - time_of(events[j]) <= kSameTime * scene.duration;) {
      const bool impact = events[k].touch.kind == ContactKind::kImpact || events[j].touch.kind == ContactKind::kImpact;
      if (impact && share(events[k].touch.candidate, events[j].touch.candidate)) return true;
    }
  }
  return false;
}

// Whether two discs may come as close to each other, without an event of theirs, as touching within rounding: moved
// closer, they meet. The paths in a step with events of one of them are known before the first of these and after the
// last, if gravity is the only force; else, and between these, two discs may touch if they are fast enough to.
bool MayPassWithoutGap(const Simulator& simulator) {
  const Scene& scene = simulator.scene();
  const double h = simulator.step();
  struct Span {
    double first = std::numeric_limits<double>::infinity(), last = -1;  // s, in the step
    void Add(double time) { first = std::min(first, time), last = std::max(last, time); }
  };
  std::map<std::pair<int, int>, Span> events;      // of steps and discs
  std::set<std::array<int, 3>> events_of_the_two;  // steps and pairs
  for (const StepTouch& at : simulator.touches()) {
    const Candidate& c = at.touch.candidate;
    events[{at.step, c.a}].Add(at.touch.time);
    if (c.plane) continue;
    events[{at.step, c.b}].Add(at.touch.time);
    events_of_the_two.insert({at.step, std::min(c.a, c.b), std::max(c.a, c.b)});
  }
  const auto coasts = [&](int i) { return !scene.table && std::ranges::count(scene.control.bodies, i) == 0; };
  std::vector<double> from(simulator.state_size()), to(simulator.state_size());
  const auto vector_at = [&](const std::vector<double>& x, int body, int offset) {
    return Vec2d(x[body * simulator.body_size() + offset], x[body * simulator.body_size() + offset + 1]);
  };
  simulator.GetState(0, to);
  for (int k = 0; k < simulator.num_steps(); ++k) {
    from.swap(to);
    simulator.GetState(k + 1, to);
    for (int a = 0; a < scene.num_bodies(); ++a) {
      for (int b = a + 1; b < scene.num_bodies(); ++b) {
        if (events_of_the_two.contains({k, a, b})) continue;
        const double touching = scene.bodies[a].radius + scene.bodies[b].radius;
        // On a path from p and v: the gap is least at one of the two times or where the discs cease to close.
        const auto touches =
            [&](const Vec2d& p, const Vec2d& v, const Vec2d& acceleration, double closing, double parting) {
              const auto place = [&](double t) -> Vec2d { return p + t * (v + 0.5 * t * acceleration); };
              const auto closes = [&](double t) { return place(t).dot(v + t * acceleration) < 0; };
              if (!closes(closing)) parting = closing;
              for (int i = 0; i < std::numeric_limits<double>::digits && !closes(parting); ++i) {
                const double t = 0.5 * (closing + parting);
                (closes(t) ? closing : parting) = t;
              }
              return std::abs(place(parting).norm() - touching) <= kPasses * touching;
            };
        const Vec2d p = vector_at(from, a, 0) - vector_at(from, b, 0),
                    v = vector_at(from, a, 2) - vector_at(from, b, 2);
        const Vec2d p_end = vector_at(to, a, 0) - vector_at(to, b, 0),
                    v_end = vector_at(to, a, 2) - vector_at(to, b, 2);
        Span span;
        for (const int i : {a, b}) {
          if (const auto found = events.find({k, i}); found != events.end()) {
            span.Add(found->second.first);
            span.Add(found->second.last);
          }
        }
        if (span.last < 0) {
          if (touches(p, v, (v_end - v) / h, 0, h)) return true;
          continue;
        }
        const bool known = coasts(a) && coasts(b);
        const Vec2d falls = scene.gravity * (scene.bodies[b].fixed - scene.bodies[a].fixed);
        if (known && touches(p, v, falls, 0, span.first)) return true;
        if (known && touches(p_end, v_end, falls, span.last - h, 0)) return true;
        if (known && span.first == span.last) continue;
        double fastest = 0;
        for (const int i : {a, b}) fastest += std::max(vector_at(from, i, 2).norm(), vector_at(to, i, 2).norm());
        if (std::min(p.norm(), p_end.norm()) - touching <= fastest * h) return true;
      }
    }
  }
  return false;
}

struct Entry {
  OneSided name;
  int variable = 0;
};

// In the order of SingleShooting's variables.
std::vector<Entry> EntriesOf(const Scene& scene) {
  std::vector<Entry> entries;
  for (const auto quantity : {OneSided::Quantity::kPosition, OneSided::Quantity::kVelocity}) {
    for (int i = 0; i < scene.num_bodies(); ++i) {
      for (int j = 0; j < 2 && !scene.bodies[i].fixed; ++j) {
        entries.push_back({{i, quantity, j}, static_cast<int>(entries.size())});
      }
    }
  }
  return entries;
}

class Sides {
 public:
  Sides(SingleShooting* shooting, double loss, std::vector<double> gradient)
      : shooting_(*shooting), loss_(loss), gradient_(std::move(gradient)) {}

  // Nothing where the derivative exists from both sides, or where differences do not tell.
  std::optional<OneSided::Side> Of(int variable, double scale) {
    const Found below = Follow(variable, -1, scale), above = Follow(variable, 1, scale);
    if (above.agrees && below.other) return OneSided::Side::kAbove;
    if (below.agrees && above.other) return OneSided::Side::kBelow;
    // Other orders to both sides, perhaps the same one: moved across the line of centers, two discs meet later whatever
    // the side.
    return above.other && below.other ? std::optional(OneSided::Side::kNone) : std::nullopt;
  }

 private:
  struct Found {
    bool agrees = false;
    std::optional<double> other;  // the slope on which differences settle instead
  };
  // By slopes at w, w/2, w/4 and w/8, of which each three on end give the value at 0 of a parabola.
  Found Follow(int variable, double sign, double scale) {
    Found found;
    double width = kWidest;
    for (int i = 0; i < kWidths; ++i, width *= kNarrower) {
      std::array<double, 4> slopes;
      for (int k = 0; k < 4; ++k) {
        const double by = sign * std::ldexp(width, -k);
        std::vector<double> z = shooting_.initial_guess();
        z[variable] += by;
        double loss = 0;
        if (!shooting_.Evaluate(z, &loss, nullptr)) return {};
        slopes[k] = (loss - loss_) / by;
      }
      const auto at_zero = [&](int k) { return slopes[k] / 3 - 2 * slopes[k + 1] + slopes[k + 2] * 8 / 3; };
      const double slope = at_zero(1), size = scale + std::abs(slope);
      if (std::abs(slope - gradient_[variable]) <= kTolerance * size) return {.agrees = true, .other = {}};
      if (std::abs(slope - at_zero(0)) <= kSmooth * size) found.other = slope;
    }
    return found;
  }

  SingleShooting& shooting_;
  const double loss_;
  const std::vector<double> gradient_;
};

}  // namespace

std::vector<OneSided> OneSidedAtOnce(const Contact& contact, const Scene& scene, const std::vector<OneSided>& known,
                                     const StopRequest& stop) {
  std::vector<OneSided> found;
  SingleShooting shooting(MakeSimulator(contact, scene, Precision::kDouble), SingleShooting::Variables::kInitialState);
  shooting.set_stop(stop);
  std::vector<double> gradient(shooting.num_variables());
  double loss = 0;
  if (!shooting.Evaluate(shooting.initial_guess(), &loss, gradient.data())) return found;
  const std::vector<Entry> entries = EntriesOf(scene);
  if (static_cast<double>(entries.size()) * scene.num_bodies() * scene.steps > kMostWork) return found;
  if (!HasImpactAtOnce(shooting.simulator()) && !MayPassWithoutGap(shooting.simulator())) return found;
  const auto largest = [&](OneSided::Quantity quantity) {
    double size = kTolerance * std::abs(loss);
    for (const Entry& entry : entries) {
      if (entry.name.quantity == quantity) size = std::max(size, std::abs(gradient[entry.variable]));
    }
    return size;
  };
  const double by_position = largest(OneSided::Quantity::kPosition),
               by_velocity = largest(OneSided::Quantity::kVelocity);
  Sides sides(&shooting, loss, gradient);
  for (const Entry& entry : entries) {
    const bool is_known = std::ranges::any_of(known, [&](const OneSided& other) {
      return other.body == entry.name.body && other.quantity == entry.name.quantity &&
             other.component == entry.name.component;
    });
    if (is_known) continue;
    const bool position = entry.name.quantity == OneSided::Quantity::kPosition;
    const std::optional<OneSided::Side> side = sides.Of(entry.variable, position ? by_position : by_velocity);
    if (shooting.stopped()) return found;
    if (!side) continue;
    found.push_back(entry.name);
    found.back().side = *side;
  }
  return found;
}

}  // namespace saltus
