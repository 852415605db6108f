// Linear systems of contact forces that undo what is measured across the contacts.
//
// Row i measures `measured` . (x_a - x_b) of some vectors x of the discs, such as velocities; its force f changes them
// by f push / m_a and -f push / m_b. The matrix of the system is as sparse as the contacts are. It is symmetric where
// both directions are the same, and singular where contacts are redundant.
#pragma once

#include <memory>
#include <span>
#include <vector>

#include "saltus/scene/geometry.h"

namespace saltus {

struct ContactRow {
  int a = 0;
  int b = -1;  // -1: a wall
  Vec2d measured{0, 0}, push{0, 0};
  // The parts of these two along the tangent of the contact, where discs that spin turn with it.
  double measured_along = 0, push_along = 0;
};

// The entry (i, j) of the matrix (Delassus operator): how much a unit force of row j changes what row i measures.
// inverse_mass: per disc, 1/kg, 0 if it does not move; turn_mobility: r^2 / I per disc, 1/kg, empty if none spins.
double Coupling(const ContactRow& i, const ContactRow& j, std::span<const double> inverse_mass,
                std::span<const double> turn_mobility = {});

// Overwrites a small n x n matrix, which lies row by row, with its pseudo-inverse, as redundant contacts make the
// matrix singular.
void PseudoInvert(int n, std::span<double> matrix);

// A large system of discs that do not spin. The solution is that of least norm, by a sparse factorization of the matrix
// with a small multiple of the identity added, iterated to convergence (proximal point iteration, Rockafellar 1976);
// where that does not converge, by the dense pseudo-inverse.
class ContactSystem {
 public:
  // The factorizations of the last few systems, for those that are the same to the bit: the system of a group that
  // rests is the same in every step. It must outlive the systems that it is given to; of one thread.
  class Cache;

  // `like`, if given, shares its factorization if its rows are nearly the same. inverse_mass as of Coupling().
  ContactSystem(std::span<const ContactRow> rows, std::span<const double> inverse_mass,
                const ContactSystem* like = nullptr, Cache* cache = nullptr);

  // Overwrites x, one number for each row, with A^+ x, or with A^+^T x. Returns whether the sparse iteration converged.
  bool Solve(std::span<double> x) const { return SolveAs(false, x); }
  bool SolveTransposed(std::span<double> x) const { return SolveAs(true, x); }
  // Solves if the sparse iteration converges; else returns false and changes nothing (no dense pseudo-inverse).
  bool SolveOnlySparse(std::span<double> x) const { return SolveSparse(false, x); }

 private:
  struct Factors;

  bool HasSamePattern(const ContactSystem& other) const;
  bool SolveAs(bool transposed, std::span<double> x) const;
  bool SolveSparse(bool transposed, std::span<double> x) const;
  void SolveDense(bool transposed, std::span<double> x) const;
  // y -= A x, or A^T x.
  void Subtract(bool transposed, std::span<const double> x, std::span<double> y) const;
  void FindFactors() const;
  void Factor() const;

  std::vector<ContactRow> rows_;      // with numbers of discs in the system, -1 if it does not move
  std::vector<double> inverse_mass_;  // by these numbers
  bool symmetric_ = true;
  Cache* cache_ = nullptr;
  mutable std::shared_ptr<Factors> factors_;  // found when first needed
  mutable std::vector<double> dense_;         // likewise
};

class ContactSystem::Cache {
 private:
  friend class ContactSystem;
  struct Known {
    std::vector<ContactRow> rows;
    std::vector<double> inverse_mass;
    std::shared_ptr<Factors> factors;
  };
  std::vector<Known> known_;  // the latest first
};

}  // namespace saltus
