// Which of several contacts are closed, stick or slide, and their forces or impulses.
#pragma once

#include <Eigen/Core>
#include <string>
#include <vector>

namespace saltus {

// With forces f, the contacts' relative accelerations are w = W f + given. Rows and columns come in pairs, normal and
// tangential, of one contact after the other; those of a contact without friction have zeros in the second place.
// Normals: 0 <= f_n - floor _|_ w_n >= 0, where the floor is zero but in the expansion of Poisson's law. Tangents, by
// the sign in `sliding`:
//
//   sliding != 0:   f_t = -mu sliding f_n
//   0:              w_t = 0 and |f_t| <= mu f_n, or f_t = -mu sign(w_t) f_n
//
// For velocities in the place of accelerations and impulses in that of forces, it is the problem of an impact.
struct ContactProblem {
  Eigen::MatrixXd W;
  Eigen::VectorXd given;
  std::vector<double> friction;    // mu of each contact
  std::vector<char> has_friction;  // of each contact; false: 'n' in the place of 's', '+' and '-'
  std::vector<int> sliding;
  std::vector<double> floor = {};  // of each normal force; none: zeros

  int size() const { return static_cast<int>(friction.size()); }
};

// A letter for each contact: 'o' open, 'n' closed without friction, '+' and '-' sliding with w_t (or v_t) > 0 and < 0,
// 's' sticking. With a floor above zero, a normal force at the floor is 'o' without friction, and with it 'P', 'M' or
// 'S' where the tangent is as in '+', '-' or 's'.
struct ContactSolution {
  std::string status;
  Eigen::VectorXd force;
};
// Whether the normal force of a contact with this status is at its floor.
inline bool IsAtFloor(char status) { return status == 'o' || status == 'P' || status == 'M' || status == 'S'; }
// The sign of w_t of a contact that slides, at its floor or above; else 0.
inline int TangentSign(char status) {
  return status == '+' || status == 'P' ? 1 : status == '-' || status == 'M' ? -1 : 0;
}

// The largest problem whose possibilities are all tried.
inline constexpr int kMostTriedContacts = 4;

// All solutions that differ in w, of problems of up to kMostTriedContacts contacts; of larger ones that which Lemke's
// method finds, if it finds one. Forces that are not unique are those of least norm. Precondition: larger problems have
// no floors.
std::vector<ContactSolution> SolveContactProblem(const ContactProblem& problem);

// The forces under which no contact accelerates along its normal, whatever their signs; without friction.
ContactSolution HoldContacts(const ContactProblem& problem);

}  // namespace saltus
