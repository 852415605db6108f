#include "saltus/feedback/covariance.h"

#include <glog/logging.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <optional>
#include <tuple>

#include "base/number_text.h"
#include "feedback/noisy_states.h"

namespace saltus {
namespace {

constexpr double kLeastProbability = 1e-12;  // of a risk that is listed
constexpr double kSameTime = 1e-12;          // s

// That a normal number with this mean and standard deviation is below zero.
double ProbabilityBelowZero(double mean, double deviation) {
  if (!(deviation > 0)) return mean < 0 ? 1 : 0;
  return 0.5 * std::erfc(mean / (deviation * std::numbers::sqrt2));
}

struct Pending {  // the event before the one that is looked at
  double time = 0;
  std::string name;
  double variance = 0;
};

}  // namespace

std::string Covariance::Warning(double small) const {
  if (!(change_probability > small)) return "";
  const SequenceRisk& largest = risks.front();
  return "the sequence of events changes with a probability of up to " + ToText(change_probability, 2) +
         ", most likely because " + largest.what + " at t = " + ToText(largest.time, 6) + " (probability " +
         ToText(largest.probability, 2) + "); covariances are of first order";
}

std::string WhatIsWrongWith(const Noise& noise, const LinearMotion& motion) {
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
    if (matrix->size() == 0) continue;
    if (std::string wrong = WhatIsWrongWithSymmetric(*matrix, size, /*definite=*/false); !wrong.empty()) {
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
  // The covariance of the time of the last event with the state at the beginning of the interval.
  std::optional<Pending> last;
  Eigen::RowVectorXd last_by_state;
  for (int k = 0; k < K; ++k) {
    const LinearInterval& at = motion.intervals[k];
    const Eigen::MatrixXd& P = out.nodes[k];
    const Eigen::Index n = at.A.cols();
    const Eigen::MatrixXd gain = regulator ? regulator->gains[k] : Eigen::MatrixXd::Zero(m, n);
    // The covariance of the control that does not come from dx.
    const Eigen::MatrixXd of_control =
        or_zero(noise.control, m) + gain * or_zero(noise.measurement, n) * gain.transpose();
    for (const LinearGuard& guard : at.guards) {
      const double variance = guard.by_state * P * guard.by_state.transpose();
      const double probability = ProbabilityBelowZero(guard.value, std::sqrt(std::max(variance, 0.0)));
      if (probability >= kLeastProbability) add_risk(guard.name + " falls below zero", at.begin, probability);
    }
    // dt = c dx + (control that does not come from dx).
    Eigen::RowVectorXd before, before_by_control;
    for (const LinearEvent& event : at.events) {
      const Eigen::RowVectorXd by_state = event.by_state - event.by_control * gain;
      const double variance = std::max(
          0.0,
          (by_state * P * by_state.transpose() + event.by_control * of_control * event.by_control.transpose()).value());
      out.event_times.push_back(std::sqrt(variance));
      if (last && event.time - last->time <= kSameTime) {
        // One follows from the other.
      } else if (last) {
        // Covariance with the time of the event before.
        const double covariance =
            before.size() > 0
                ? (before * P * by_state.transpose() + before_by_control * of_control * event.by_control.transpose())
                      .value()
                : (last_by_state * by_state.transpose()).value();
        const double difference = std::max(0.0, variance + last->variance - 2 * covariance);
        add_risk(event.name + " comes before " + last->name,
                 event.time,
                 ProbabilityBelowZero(event.time - last->time, std::sqrt(difference)));
      } else {
        add_risk(event.name + " comes before the beginning",
                 event.time,
                 ProbabilityBelowZero(event.time - motion.intervals[0].begin, out.event_times.back()));
      }
      last = Pending{event.time, event.name, variance};
      before = by_state;
      before_by_control = event.by_control;
    }
    const Eigen::MatrixXd transition = at.A - at.B * gain;
    out.nodes.push_back(transition * P * transition.transpose() + at.B * of_control * at.B.transpose() +
                        or_zero(noise.process, at.A.rows()));
    if (before.size() > 0) {
      last_by_state = before * P * transition.transpose() + before_by_control * of_control * at.B.transpose();
    } else if (last) {
      last_by_state = last_by_state * transition.transpose();
    }
  }
  if (last) {
    add_risk(last->name + " comes after the end",
             last->time,
             ProbabilityBelowZero(motion.end - last->time, std::sqrt(last->variance)));
  }
  std::ranges::stable_sort(out.risks,
                           [](const SequenceRisk& a, const SequenceRisk& b) { return a.probability > b.probability; });
  return out;
}

}  // namespace saltus
