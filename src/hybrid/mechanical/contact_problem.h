// Which of several contacts are closed, stick or slide, and their forces or impulses.
#pragma once

#include <Eigen/Core>
#include <optional>
#include <string>
#include <vector>

#include "base/linear_algebra.h"

namespace saltus {

// Least squares solutions of least norm for a square matrix, block by block: rows and columns are in one block where an
// entry couples them. Forces of a block whose right side is zero are exactly zero, whatever the rounding errors of the
// others: those along the tangents of a column at rest do not make it fall. Large blocks are solved for the forces that
// are no internal stresses between two bodies, of which there are fewer.
class BlockSolver {
 public:
  // `threshold`: as of LeastNormSolver, within each block.
  BlockSolver(const Eigen::MatrixXd& matrix, double threshold);
  // `solution` may be `right`.
  void Solve(const Eigen::VectorXd& right, Eigen::VectorXd& solution) const;

 private:
  struct Block {
    std::vector<Eigen::Index> rows;
    std::optional<Eigen::MatrixXd> moving;  // MovingForces of a large block, which are solved for
    LeastNormSolver solver;
  };
  std::vector<Block> blocks_;
};

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
  Eigen::VectorXd terms = {};      // sizes of the terms that add up to `given`; none: |given|

  int size() const { return static_cast<int>(friction.size()); }
};

// A letter for each contact: 'o' open, 'n' closed without friction, '+' and '-' sliding with w_t (or v_t) > 0 and < 0,
// 's' sticking. A contact with friction is 'n' if its mu is zero and w_t too. With a floor above zero, a normal force
// at the floor is 'o' without friction, and with it 'P', 'M' or 'S' where the tangent is as in '+', '-' or 's'.
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

// All solutions that differ in w, of problems of up to kMostTriedContacts contacts; of larger ones that in which all
// stay closed and stick, or else that which Lemke's method or projected Gauss-Seidel finds. The status has as many
// contacts closed, and of these as many sticking, as w allows. Forces that are not unique are those of SplitForces. A
// solution that needs internal stresses counts only if there is none without. Precondition: larger problems have no
// floors.
std::vector<ContactSolution> SolveContactProblem(const ContactProblem& problem);

// Whether a problem is too large for SolveContactProblem.
bool IsTooLarge(const ContactProblem& problem);

// The forces under which no contact accelerates along its normal, and those that stick not along their tangents either,
// whatever their signs; without friction at the others. Returns std::nullopt where rows that nearly depend on each
// other leave none, but zeros if nothing accelerates by more than `still`.
std::optional<ContactSolution> HoldContacts(const ContactProblem& problem, const std::vector<char>& sticks,
                                            double still);

// ---------------------------------------------------------------------------------------------------------------------
// Forces that are not unique.

// Where the unknown forces of a contact are among all that are unknown; -1: its force is known, or it has none.
struct UnknownForces {
  Eigen::Index normal = -1, tangent = -1;
  double friction = 0;
  double known = 0;  // the normal force, or the floor of one that is unknown
};
// The limits of forces x, rows x + constants >= 0: no normal force is below its floor, and tangential forces are within
// the cone of friction.
struct ForceLimits {
  Eigen::MatrixXd rows;
  Eigen::VectorXd constants;
};
ForceLimits LimitsOf(const std::vector<UnknownForces>& contacts, Eigen::Index num_forces);

// Returns the rounding errors of forces f with matrix f = right: of each, by its size and those of the forces that
// depend on it. `terms`: sizes of the terms that add up to `right`. A force past a limit by less is at the limit.
Eigen::VectorXd ForceTolerances(const Eigen::MatrixXd& matrix, const Eigen::VectorXd& force,
                                const Eigen::VectorXd& terms);

// Returns an orthonormal basis of internal stresses: contact forces that move nothing, as where two corners of a body
// stick. `matrix`: accelerations along the rows of the contacts by their forces.
Eigen::MatrixXd InternalStresses(const Eigen::MatrixXd& matrix);

// The forces x + stresses y that are farthest from their limits, as large as the smallest of the limits can be: of each
// group of contacts that share stresses by itself. Normal forces add up to no more than twice what they do in x.
struct ForceSplit {
  Eigen::VectorXd force;
  struct Group {
    std::vector<Eigen::Index> stresses;  // columns
    std::vector<std::size_t> contacts;
    // The limits that are the smallest, one more than there are stresses, and their derivatives by [y, -smallest]; -1:
    // a bound that is none of the limits.
    std::vector<Eigen::Index> tight;
    Eigen::MatrixXd by_stress;
  };
  std::vector<Group> groups = {};
};
ForceSplit SplitForces(const Eigen::VectorXd& force, const Eigen::MatrixXd& stresses,
                       const std::vector<UnknownForces>& contacts);

}  // namespace saltus
