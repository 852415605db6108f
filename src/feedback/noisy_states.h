// Normal errors of states, and how a hybrid system goes on from a state that noise or a measurement has put behind a
// guard.
#pragma once

#include <Eigen/Core>
#include <span>
#include <string>
#include <vector>

#include "saltus/feedback/regulator.h"
#include "saltus/hybrid/hybrid_simulator.h"

namespace saltus {

// The reason why Track() returns empty gains.
inline constexpr char kNoRegulator[] =
    "the weights of the regulator differ too much for double precision: R + B' S B, or a gain, cannot be computed; "
    "choose "
    "Q, R and QT of more similar sizes";

// Whether A and B are finite in all intervals: otherwise there is no regulator, and no covariance.
bool IsFinite(const LinearMotion& motion);

using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

// The mode in which the motion goes on under a control; guards that are below zero there and fall have their events at
// once. Adds the guards to `events`, if it is not null; multiplies `saltation` from the left by the saltation matrices,
// if it is not null. False if there is no such mode, or if there are more than 100 events.
bool TakeEventsBehindGuards(const HybridSystem& system, double t, std::span<const double> control,
                            std::span<const double> parameters, int* mode, Eigen::VectorXd* x,
                            std::vector<HybridEvent>* events, Eigen::MatrixXd* saltation);

// Checks a symmetric matrix of `size` rows that must be positive (semi)definite: "found x, expected y", empty if it is.
std::string ValidateSymmetric(const Eigen::MatrixXd& matrix, Eigen::Index size, bool definite);

// A matrix L with L L' = covariance, of as many columns as its rank; no columns if it is empty.
Eigen::MatrixXd RootOfCovariance(const Eigen::MatrixXd& covariance);

}  // namespace saltus
