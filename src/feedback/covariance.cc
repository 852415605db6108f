#include "saltus/feedback/covariance.h"

#include <glog/logging.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <numbers>
#include <set>
#include <tuple>

#include "base/number_text.h"
#include "feedback/noisy_states.h"

namespace saltus {
namespace {

constexpr double kLeastProbability = 1e-12;  // of a risk that is listed
constexpr double kSameDeviation = 1e-7;      // of the deviations of two times: that of their difference
constexpr double kNoDeviation = 1e-7;        // of the deviations of the terms of a sum: that of the sum, by rounding

// Returns the probability that a normal number with this mean and standard deviation is below zero.
double ProbabilityBelowZero(double mean, double deviation) {
  if (!(deviation > 0)) return mean < 0 ? 1 : 0;
  return 0.5 * std::erfc(mean / (deviation * std::numbers::sqrt2));
}

// An event that no other of its discs has followed so far.
struct Pending {
  double time = 0;
  std::string name;
  double variance = 0;
  int interval = 0;
  Eigen::RowVectorXd by_state, by_control;  // of its time, in its interval
  Eigen::RowVectorXd with_state;            // covariance of its time with the state at the beginning of a later one
};

}  // namespace

std::string Covariance::Warning(double small) const {
  if (!(change_probability > small)) return "";
  const SequenceRisk& largest = risks.front();
  return "the sequence of events changes with a probability of up to " + ToText(change_probability, 2) +
         ", most likely because " + largest.description + " at t = " + ToText(largest.time, 6) + " (probability " +
         ToText(largest.probability, 2) + "); covariances are of first order";
}

std::string Validate(const Noise& noise, const LinearMotion& motion) {
  const Eigen::Index n = motion.intervals.front().A.cols(), m = motion.intervals.front().B.cols();
  for (const LinearInterval& interval : motion.intervals) {
    if ((noise.process.size() > 0 && interval.A.rows() != n) ||
        (noise.measurement.size() > 0 && interval.A.cols() != n)) {
      return "process and measurement noise: the states of the motion's modes differ in size, expected one size";
    }
  }
  for (const auto& [what, matrix, size] : {std::tuple("initial state", &noise.initial, n),
                                           std::tuple("control", &noise.control, m),
                                           std::tuple("process", &noise.process, n),
                                           std::tuple("measurement", &noise.measurement, n)}) {
    if (matrix->rows() == 0 && matrix->cols() == 0) continue;
    if (std::string wrong = ValidateSymmetric(*matrix, size, /*definite=*/false); !wrong.empty()) {
      return "covariance of the " + std::string(what) + ": " + wrong;
    }
  }
  return "";
}

Covariance Propagate(const LinearMotion& motion, const Noise& noise, const Regulator* regulator) {
  const auto K = static_cast<int>(motion.intervals.size());
  CHECK(K > 0);
  const Eigen::Index n0 = motion.intervals[0].A.cols(), m = motion.intervals[0].B.cols();
  const auto or_zero = [](const Eigen::MatrixXd& matrix, Eigen::Index size) -> Eigen::MatrixXd {
    if (matrix.size() == 0) return Eigen::MatrixXd::Zero(size, size);
    CHECK(matrix.rows() == size && matrix.cols() == size) << "a covariance of another size than what it is of";
    return matrix;
  };
  Covariance out;
  out.nodes.reserve(K + 1);  // referred to below
  out.nodes.push_back(or_zero(noise.initial, n0));
  const auto add_risk = [&](std::string what, double time, double probability) {
    out.change_probability = std::min(1.0, out.change_probability + probability);
    if (probability >= kLeastProbability) out.risks.push_back({std::move(what), time, probability});
  };
  Eigen::VectorXd largest;  // variances of the state so far, whose rounding errors later ones have
  std::vector<Pending> events;
  std::map<int, std::size_t> last_of;  // the last event of each disc; of a hybrid system, of all (-1)
  for (int k = 0; k < K; ++k) {
    const LinearInterval& at = motion.intervals[k];
    const Eigen::MatrixXd& P = out.nodes[k];
    const Eigen::Index n = at.A.cols();
    if (largest.size() != n) largest.setZero(n);
    largest = largest.cwiseMax(P.diagonal());
    const Eigen::MatrixXd gain = regulator ? regulator->gains[k] : Eigen::MatrixXd::Zero(m, n);
    // The covariance of the control that does not come from dx.
    const Eigen::MatrixXd of_control =
        or_zero(noise.control, m) + gain * or_zero(noise.measurement, n) * gain.transpose();
    // Returns the covariance of by_state dx + by_control du, where du is the control that does not come from dx.
    const auto covariance = [&](const Eigen::RowVectorXd& state,
                                const Eigen::RowVectorXd& control,
                                const Eigen::RowVectorXd& other_state,
                                const Eigen::RowVectorXd& other_control) {
      return (state * P * other_state.transpose() + control * of_control * other_control.transpose()).value();
    };
    for (const LinearGuard& guard : at.guards) {
      const Eigen::RowVectorXd by_state = guard.by_state - guard.by_control * gain;
      const double variance = covariance(by_state, guard.by_control, by_state, guard.by_control);
      const double rounding =
          kNoDeviation * (guard.by_control.cwiseAbs() * of_control.diagonal().cwiseMax(0).cwiseSqrt() +
                          by_state.cwiseAbs() * largest.cwiseSqrt())
                             .value();
      const double probability =
          ProbabilityBelowZero(guard.value, variance > rounding * rounding ? std::sqrt(variance) : 0);
      if (probability >= kLeastProbability) add_risk(guard.name + " falls below zero", guard.time, probability);
    }
    for (const LinearEvent& event : at.events) {
      Pending now{event.time, event.name, 0, k, event.by_state - event.by_control * gain, event.by_control, {}};
      now.variance = std::max(0.0, covariance(now.by_state, now.by_control, now.by_state, now.by_control));
      out.event_times.push_back(std::sqrt(now.variance));
      const std::vector<int> discs = event.discs.empty() ? std::vector<int>{-1} : event.discs;
      std::set<std::size_t> before;
      for (const int disc : discs) {
        if (const auto last = last_of.find(disc); last != last_of.end()) before.insert(last->second);
        last_of[disc] = events.size();
      }
      for (const std::size_t i : before) {
        const Pending& last = events[i];
        if (event.immediate) continue;
        double variance = 0;
        if (last.interval == k) {
          const Eigen::RowVectorXd by_state = now.by_state - last.by_state,
                                   by_control = now.by_control - last.by_control;
          variance = covariance(by_state, by_control, by_state, by_control);
        } else {
          variance = now.variance + last.variance - 2 * last.with_state.dot(now.by_state);
        }
        const double rounding = kSameDeviation * kSameDeviation * (now.variance + last.variance);
        add_risk(event.name + " comes before " + last.name,
                 event.time,
                 ProbabilityBelowZero(event.time - last.time, std::sqrt(variance > rounding ? variance : 0)));
      }
      if (before.empty()) {
        add_risk(event.name + " comes before the beginning",
                 event.time,
                 ProbabilityBelowZero(event.time - motion.intervals[0].begin, out.event_times.back()));
      }
      events.push_back(std::move(now));
    }
    const Eigen::MatrixXd transition = at.A - at.B * gain;
    out.nodes.push_back(transition * P * transition.transpose() + at.B * of_control * at.B.transpose() +
                        or_zero(noise.process, at.A.rows()));
    std::set<std::size_t> last;
    for (const auto& [disc, i] : last_of) last.insert(i);
    for (const std::size_t i : last) {
      Pending& event = events[i];
      if (event.interval == k) {
        event.with_state =
            event.by_state * P * transition.transpose() + event.by_control * of_control * at.B.transpose();
      } else {
        event.with_state = (event.with_state * transition.transpose()).eval();
      }
    }
  }
  std::set<std::size_t> last;
  for (const auto& [disc, i] : last_of) last.insert(i);
  for (const std::size_t i : last) {
    add_risk(events[i].name + " comes after the end",
             events[i].time,
             ProbabilityBelowZero(motion.end - events[i].time, std::sqrt(events[i].variance)));
  }
  std::ranges::stable_sort(out.risks,
                           [](const SequenceRisk& a, const SequenceRisk& b) { return a.probability > b.probability; });
  return out;
}

}  // namespace saltus
