// Covariance of the error of a motion, to first order through its events, and the probability of another sequence of
// events.
//
// At the beginning of each interval the state is measured; the control then differs from the plan by -K (dx + error of
// the measurement) and by its own noise:
//
//   P_{k+1} = (A - B K) P_k (A - B K)' + B (K V K' + U) B' + W,
//
// with K = 0 in open loop, where ' is the transpose. A and B contain the saltation matrices Xi of the events, across
// which P+ = Xi P- Xi'.
#pragma once

#include <Eigen/Core>
#include <string>
#include <vector>

#include "saltus/feedback/regulator.h"

namespace saltus {

// Independent normal errors with mean zero, by their covariance matrices, which are symmetric and positive
// semidefinite. An empty matrix: no error.
struct Noise {
  Eigen::MatrixXd initial = {};      // P_0, of the initial state
  Eigen::MatrixXd control = {};      // U, of the control in each interval
  Eigen::MatrixXd process = {};      // W, of the state at the end of each interval
  Eigen::MatrixXd measurement = {};  // V, of the measured state at the beginning of each interval
};

// Checks sizes, symmetry, and that matrices are positive semidefinite. Returns the first error as "found x, expected
// y"; empty if there is none.
std::string Validate(const Noise& noise, const LinearMotion& motion);

// A possible change of the sequence of events.
struct SequenceRisk {
  std::string description = {};  // "'a' comes after 'b'", "'a' comes after the end", "'a' comes ..."
  double time = 0;               // s, of the planned event, or of the guard's value
  double probability = 0;        // to first order
};

struct Covariance {
  std::vector<Eigen::MatrixXd> nodes = {};  // K + 1: at the beginning of each interval, and at the end
  std::vector<double> event_times = {};     // standard deviations of the times of the events, s
  // All risks with a probability of 1e-12 or more, the largest first. That of an event after the next one, after the
  // end or before the beginning follows from the normal distribution of the difference of the times. That of a guard
  // that should stay above zero follows from the distribution of its value where it is least (LinearGuard).
  std::vector<SequenceRisk> risks = {};
  // An upper bound (Boole's inequality) on the probability that one of them happens, at most 1.
  double change_probability = 0;
  // Returns a text with the largest risk if change_probability is above `small`, where first order does not suffice;
  // otherwise empty.
  std::string Warning(double small = 0.01) const;
};

// Propagates the covariance under a regulator, or in open loop if it is null. Preconditions: Validate() returns an
// empty text for noise and regulator, and the motion has an interval.
Covariance Propagate(const LinearMotion& motion, const Noise& noise, const Regulator* regulator = nullptr);

}  // namespace saltus
