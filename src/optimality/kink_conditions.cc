#include "optimality/kink_conditions.h"

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <limits>
#include <string>

#include "base/linear_algebra.h"
#include "optimality/optimality_conditions.h"
#include "saltus/control/contact_sequence.h"
#include "saltus/control/objective.h"
#include "saltus/simulate/exact_run.h"
#include "simulate/flight.h"

namespace saltus {
namespace {

using Eigen::VectorXd;

constexpr double kAtEnd = 1e-6;   // of the duration
constexpr double kTouch = 1e-6;   // of the distance of a contact
constexpr double kApart = 1e-3;   // of the duration, between a touch and an impact of the same pair
constexpr double kKick = 1e-5;    // an impulse, in natural units
constexpr double kNoJump = 1e-9;  // of the loss

struct Kink {
  Candidate pair;
  double time = 0;
  bool strikes = false;
};

class KinkCertifier {
 public:
  KinkCertifier(const Scene& scene, const std::vector<double>& initial, const std::vector<double>& control,
                const std::vector<double>& lengths, const ExactRun& exact, const StopRequest& stop)
      : scene_(scene),
        initial_(initial),
        control_(control),
        lengths_(lengths),
        exact_(exact),
        stop_(stop),
        flight_(scene, initial, control, lengths, exact) {}

  Certificate Run() {
    Certificate certificate;
    FindKinks();
    if (kinks_.empty()) return certificate;
    const VectorXd with = Gradient(), multipliers = Multipliers(with);
    const double residual = Residual(with, multipliers);
    if (!(residual <= kCertificateTolerance)) return certificate;
    certificate.stationarity = residual;
    certificate.verdict = Certificate::Verdict::kStationaryOnGrid;
    std::string names;
    for (std::size_t i = 0; i < kinks_.size(); ++i) {
      const Kink& kink = kinks_[i];
      const double multiplier = kink.strikes ? -multipliers[i] : multipliers[i];
      const auto& [a, b] = NamesOf(kink.pair);
      certificate.impacts.push_back({.time = kink.time,
                                     .a = a,
                                     .b = b,
                                     .speed = 0,
                                     .multiplier = multiplier,
                                     .on_node = true,
                                     .theta = std::nullopt});
      const std::string name = a + "-" + b + (kink.strikes ? " strike at the final time" : " just touch");
      names += (names.empty() ? "" : ", ") + name;
      const std::string wrong = multiplier < -Noise() ? "on the side of this motion" : WhyOtherSideIsLess(kink, i);
      if (wrong.empty()) continue;
      certificate.verdict = Certificate::Verdict::kNotStationary;
      certificate.reason = name + ", and the loss falls " + wrong;
      return certificate;
    }
    certificate.reason = names + ": a kink, with multipliers of the right sign on both sides";
    return certificate;
  }

 private:
  std::pair<std::string, std::string> NamesOf(const Candidate& pair) const {
    return {scene_.bodies[pair.a].name, pair.plane ? scene_.planes[pair.b].name : scene_.bodies[pair.b].name};
  }

  void FindKinks() {
    for (const Flight::Hit& hit : flight_.hits()) {
      if (hit.time >= scene_.duration * (1 - kAtEnd)) kinks_.push_back({hit.contact, hit.time, true});
    }
    for (const Candidate& pair : AllPairs(scene_)) {
      const auto [time, gap] = NearestPassOf(scene_, flight_, pair);
      const bool near = std::ranges::any_of(flight_.hits(), [&, at = time](const Flight::Hit& hit) {
        return hit.contact == pair && std::abs(hit.time - at) <= kApart * scene_.duration;
      });
      if (!near && time > 0 && std::abs(gap) <= kTouch) kinks_.push_back({pair, time, false});
    }
    gaps_.resize(static_cast<Eigen::Index>(control_.size()), static_cast<Eigen::Index>(kinks_.size()));
    for (Eigen::Index i = 0; i < gaps_.cols(); ++i) gaps_.col(i) = GapGradient(kinks_[i]);
  }

  // The motion until `time`, without the impacts from there on.
  struct Part {
    std::vector<double> control, lengths;
    ExactRun run;
  };
  Part Until(double time) const {
    Part part;
    double begin = 0;
    for (std::size_t k = 0; k < lengths_.size() && begin < time; begin += lengths_[k++]) {
      part.lengths.push_back(std::min(lengths_[k], time - begin));
      const auto row = control_.begin() + static_cast<std::ptrdiff_t>(scene_.ForceIndex(k, 0));
      part.control.insert(part.control.end(), row, row + scene_.control_width());
    }
    part.run.ok = true;
    for (std::size_t i = 0; i < flight_.hits().size(); ++i) {
      if (flight_.hits()[i].time >= time - kAtEnd * scene_.duration) break;
      part.run.contacts.push_back(exact_.contacts[i]);
      part.run.places.push_back(exact_.places[i]);
    }
    return part;
  }

  // Returns the gradient of the gap at the kink by the control; to first order the gap is linear in the positions.
  VectorXd GapGradient(const Kink& kink) const {
    Scene scene = scene_;
    scene.duration = kink.time;
    scene.objective = {};
    const Vec2d normal = SeparationOf(scene_, kink.pair, flight_.Before(kink.time).p).normal;
    for (int side = 0; side < (kink.pair.plane ? 1 : 2); ++side) {
      for (int j = 0; j < 2; ++j) {
        const int body = side == 0 ? kink.pair.a : kink.pair.b;
        scene.objective.terminal.push_back(
            {.body = body, .component = j, .weight = side == 0 ? normal[j] : -normal[j]});
      }
    }
    const Part part = Until(kink.time);
    const Flight flight(scene, initial_, part.control, part.lengths, part.run);
    const VectorXd until = CondensedLoss(scene, flight, part.control, part.lengths).Gradient();
    VectorXd gradient = VectorXd::Zero(static_cast<Eigen::Index>(control_.size()));
    gradient.head(until.size()) = until;
    return gradient;
  }

  // Returns the gradient of the loss, with the strikes at the final time.
  VectorXd Gradient() const {
    std::vector<std::optional<double>> early(flight_.hits().size());
    for (std::size_t k = 0; k < early.size(); ++k) {
      if (flight_.hits()[k].time >= scene_.duration * (1 - kAtEnd)) early[k] = 1;
    }
    return CondensedLoss(scene_, flight_, control_, lengths_, std::move(early)).Gradient();
  }

  VectorXd Multipliers(const VectorXd& gradient) const { return LeastSquaresSolution(gaps_, gradient); }

  // Returns the residual of 2 effort m u + lambda_v in the mean over an interval, relative to the largest 2 effort m u.
  double Residual(const VectorXd& gradient, const VectorXd& multipliers) const {
    const VectorXd left = gradient - gaps_ * multipliers;
    double largest = 0, scale = 0;
    const int width = scene_.control_width();
    for (Eigen::Index i = 0; i < left.size(); ++i) {
      const double mass = scene_.bodies[scene_.control.bodies[i % width / 2]].mass;
      largest = std::max(largest, mass / lengths_[i / width] * std::abs(left[i]));
      scale = std::max(scale, 2 * scene_.objective.effort * mass * std::abs(control_[i]));
    }
    return largest / std::max(scale, 1e-300);
  }

  // Returns the rounding error of multipliers and slopes.
  double Noise() const { return kNoJump * std::max(1.0, std::abs(exact_.loss)); }

  std::string WhyOtherSideIsLess(const Kink& kink, std::size_t i) const {
    if (!kink.strikes) return SlopeByImpulse(kink) < -kCertificateTolerance ? "with an impact" : "";
    const Part part = Until(scene_.duration);
    const Flight flight(scene_, initial_, control_, lengths_, part.run);
    const auto terminal = [&](const DiscStates& end) {
      std::vector<double> state;
      for (std::size_t body = 0; body < end.p.size(); ++body) {
        state.insert(state.end(), {end.p[body][0], end.p[body][1], end.v[body][0], end.v[body][1]});
      }
      return TerminalLoss(scene_.objective, state, 4);
    };
    const double jump = terminal(flight.end()) - terminal(flight_.end());
    if (std::abs(jump) > Noise()) return jump < 0 ? "without the impact" : "";
    const VectorXd without = CondensedLoss(scene_, flight, control_, lengths_).Gradient();
    const VectorXd multipliers = Multipliers(without);
    if (Residual(without, multipliers) > kCertificateTolerance) return "without the impact";
    return multipliers[static_cast<Eigen::Index>(i)] < -Noise() ? "without the impact" : "";
  }

  // Returns the derivative of the loss by an impulse between the pair as it touches.
  double SlopeByImpulse(const Kink& kink) const {
    Scene rest = scene_;
    rest.duration = scene_.duration - kink.time;
    const Part part = Until(kink.time);
    const std::size_t skipped = part.lengths.size() - 1;
    std::vector<double> lengths(lengths_.begin() + static_cast<std::ptrdiff_t>(skipped), lengths_.end());
    lengths[0] -= part.lengths.back();
    const std::vector<double> control(control_.begin() + static_cast<std::ptrdiff_t>(scene_.ForceIndex(skipped, 0)),
                                      control_.end());
    const DiscStates x = flight_.Before(kink.time);
    const Vec2d normal = SeparationOf(scene_, kink.pair, x.p).normal;
    const ImpactConstants law = MakeImpactConstants(scene_, kink.pair);
    const auto loss = [&](double impulse) {
      std::vector<double> start;
      for (int body = 0; body < scene_.num_bodies(); ++body) {
        Vec2d v = x.v[body];
        if (body == kink.pair.a) v += impulse * law.inverse_mass_a * normal;
        if (!kink.pair.plane && body == kink.pair.b) v -= impulse * law.inverse_mass_b * normal;
        start.insert(start.end(), {x.p[body][0], x.p[body][1], v[0], v[1]});
      }
      const ExactRun run = SimulateExactly(rest, start, control, lengths, stop_);
      return run.ok ? run.loss : std::numeric_limits<double>::quiet_NaN();
    };
    return (loss(2 * kKick) - loss(kKick)) / kKick;
  }

  const Scene& scene_;
  const std::vector<double>&initial_, &control_, &lengths_;
  const ExactRun& exact_;
  const StopRequest& stop_;
  Flight flight_;
  std::vector<Kink> kinks_;
  Eigen::MatrixXd gaps_;  // the derivatives of their gaps by the control, a column each
};

}  // namespace

Certificate CertifyKinks(const Scene& scene, const std::vector<double>& initial, const std::vector<double>& control,
                         const std::vector<double>& durations, const StopRequest& stop) {
  Certificate none;
  if (!BeyondTerminalCost(scene).empty() || scene.num_turned() > 0 || scene.Spins() || scene.objective.effort == 0 ||
      !BeyondPlanes(scene).empty()) {
    return none;
  }
  const ExactRun exact = SimulateExactly(scene, initial, control, durations, stop);
  if (!exact.ok || !exact.only_impacts || !exact.ambiguous.empty()) return none;
  const std::vector<double> lengths = IntervalLengths(scene, control, durations);
  return KinkCertifier(scene, initial, control, lengths, exact, stop).Run();
}

}  // namespace saltus
