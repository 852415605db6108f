// Contacts with friction as a linear complementarity problem.
#pragma once

#include <Eigen/Core>
#include <optional>
#include <span>

namespace saltus {

// The forces of contacts, normal and tangential of one after the other, under which none accelerates into its contact,
// none pulls, and friction obeys Coulomb's law: against the sign in `sliding`, or, where that is 0, against what would
// begin; each contact has its own coefficient of friction. With responses R and the accelerations a that are given without forces, of the same shape, contacts have
// R f + a. Nothing if there are none, or none are found; so if the problem has more rows than kMostComplementaryRows.
std::optional<Eigen::VectorXd> SolveFrictionalLcp(std::span<const double> friction, const Eigen::MatrixXd& responses,
                                                  const Eigen::VectorXd& given, std::span<const int> sliding);

inline constexpr int kMostComplementaryRows = 800;  // one of each contact, three more of each that does not slide

}  // namespace saltus
