// The trajectory of all discs under a piecewise constant control in exact dynamics: pieces of constant acceleration
// (linear and angular) and the impacts between them, from the events that an exact run has found.
#pragma once

#include <array>
#include <optional>
#include <span>
#include <vector>

#include "base/short_vector.h"
#include "saltus/scene/scene.h"
#include "saltus/simulate/exact_run.h"
#include "simulate/impact.h"

namespace saltus {

// Position and velocity of one disc.
struct DiscState {
  Vec2d p, v;  // m, m/s

  // Returns the position or the velocity, as a term's quantity asks for.
  const Vec2d& Get(TerminalTerm::Quantity quantity) const {
    return quantity == TerminalTerm::Quantity::kPosition ? p : v;
  }
};

// A number or a vector of every disc. There are several of each in every interval of a flight.
template <typename T>
using DiscArray = ShortVector<T, 4>;

struct DiscStates {
  DiscArray<Vec2d> p, v;                    // m and m/s, of every disc
  DiscArray<double> angle = {}, spin = {};  // rad and rad/s, of every disc if one spins
  // Returns the angular velocities of a and b, rad/s; 0 for planes, and where nothing spins.
  std::array<double, 2> SpinsOf(const Candidate& c) const {
    if (spin.empty()) return {0, 0};
    return {spin[c.a], c.plane ? 0.0 : spin[c.b]};
  }
};

class Flight {
 public:
  // The motion of all discs over a part of one control interval.
  struct Piece {
    int interval = 0;
    double start = 0, duration = 0;  // s
    DiscStates at_start;
    DiscArray<Vec2d> acceleration;   // m/s^2, of every disc, gravity included
    DiscArray<double> turning = {};  // rad/s^2, of every disc; empty if none is turned

    double TurningOf(int body) const { return turning.empty() ? 0.0 : turning[body]; }
    // Return the state `s` seconds after the start: of one disc, and of all.
    DiscState StateAfter(int body, double s) const {
      const Vec2d &p = at_start.p[body], &v = at_start.v[body], &a = acceleration[body];
      return {p + s * (v + 0.5 * s * a), v + s * a};
    }
    DiscStates StateAfter(double s) const;
  };
  struct Hit {
    double time = 0;
    Candidate contact;
    int next_piece = 0;    // the piece that starts here
    bool on_node = false;  // at the boundary of two control intervals
    DiscStates before;     // all discs just before
    Impact<double> impact;
  };

  // `run` is the exact run of `initial` and `control` on intervals of `durations`. Preconditions: run.ok, and
  // durations.size() rows in `control`.
  Flight(const Scene& scene, std::span<const double> initial, std::span<const double> control,
         std::span<const double> durations, const ExactRun& run);

  const std::vector<Piece>& pieces() const { return pieces_; }
  const std::vector<Hit>& hits() const { return hits_; }
  const DiscStates& end() const { return end_; }

  // Returns the states just before `time`, which lies in [0, T].
  DiscStates StatesBefore(double time) const;

 private:
  std::vector<Piece> pieces_;
  std::vector<Hit> hits_;
  DiscStates end_;
};

// Returns the target of a running term at time t.
template <typename T>
Vec2<T> TargetAt(const RunningTerm& term, const T& t) {
  size_t next = 0;
  while (next < term.times.size() && term.times[next] <= Value(t)) ++next;
  if (next == 0) return term.targets.front().cast<T>();
  if (next == term.times.size()) return term.targets.back().cast<T>();
  const double length = term.times[next] - term.times[next - 1];
  const Vec2d& from = term.targets[next - 1];
  return from.cast<T>() + Scale(T((t - term.times[next - 1]) / length), Vec2d(term.targets[next] - from));
}

// Nodes and weights of the quadrature of Gauss and Legendre on [0, 1], exact for the square of a quadratic.
inline constexpr std::array<double, 3> kGaussNodes = {0.11270166537925831, 0.5, 0.88729833462074169};
inline constexpr std::array<double, 3> kGaussWeights = {5.0 / 18, 4.0 / 9, 5.0 / 18};

// Returns the acceleration of a disc under gravity and the first of its forces, m/s^2; zero if it is fixed.
Vec2d InitialAcceleration(const Scene& scene, int body);

// Returns the cost of the running terms and soft via terms on a trajectory. Integrals are exact, cut at impacts and
// where targets turn.
double RunningLoss(const Scene& scene, const Flight& flight);

// Simulates as SimulateExactly() does, but ends in the step in which the motion has had more than `most_impacts`
// impacts, and reports that as the reason. For trial motions, whose impacts might accumulate without limit.
ExactRun SimulateUpTo(std::optional<int> most_impacts, const Scene& scene, const std::vector<double>& initial,
                      const std::vector<double>& control, const std::vector<double>& durations = {},
                      const StopRequest& stop = nullptr);

}  // namespace saltus
