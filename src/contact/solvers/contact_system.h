// Linear systems of contact: the forces across contacts that undo what is measured across them.
//
// Row i measures `measured` . (x_a - x_b) of some vectors x of the discs, such as velocities; its force f moves them by
// f push / m_a and -f push / m_b. The matrix of the system, how much force j changes what row i measures, is as sparse
// as the contacts are. It is symmetric where both directions are one, and singular where contacts depend on each other.
#pragma once

#include <memory>
#include <span>
#include <vector>

#include "saltus/scene/geometry.h"

namespace saltus {

struct ContactRow {
  int a = 0;
  int b = -1;  // -1: a plane
  Vec2d measured{0, 0}, push{0, 0};
};

// Systems of up to so many rows are inverted as dense matrices.
inline constexpr int kMostDenseRows = 16;
// Of a dense matrix: the pivots of rows that depend on others, relative to the largest.
inline constexpr double kDependentRows = 1e-10;

// How much the force of row j changes what row i measures.
double Coupling(const ContactRow& i, const ContactRow& j, std::span<const double> inverse_mass);

// Pseudo-inverse of a small square matrix, for equations of which some may follow from others. `matrix`: n x n, row by
// row; overwritten.
void PseudoInvert(int n, std::span<double> matrix);

// A large system. Solutions are those of least norm, by a sparse factorization of the matrix with a small multiple of
// the identity added, corrected until nothing is left (proximal point iteration, Rockafellar 1976); where that does not
// arrive, by the dense pseudo-inverse.
class ContactSystem {
 public:
  // `like`, if given, lends its factorization if its rows are nearly the same. inverse_mass: per disc, 1/kg; 0 if it
  // does not move.
  ContactSystem(std::span<const ContactRow> rows, std::span<const double> inverse_mass,
                const ContactSystem* like = nullptr);

  // Overwrites x, one number a row, with A^+ x, or with A^+^T x. True if the sparse factorization has arrived there.
  bool Solve(std::span<double> x) const { return SolveAs(false, x); }
  bool SolveTransposed(std::span<double> x) const { return SolveAs(true, x); }
  // As Solve, but false, and nothing changed, where only the dense pseudo-inverse would do.
  bool SolveOnlySparse(std::span<double> x) const { return SolveSparse(false, x); }

 private:
  struct Factors;

  bool IsLike(const ContactSystem& other) const;
  bool SolveAs(bool transposed, std::span<double> x) const;
  bool SolveSparse(bool transposed, std::span<double> x) const;
  void SolveDense(bool transposed, std::span<double> x) const;
  // y -= A x, or A^T x.
  void Subtract(bool transposed, std::span<const double> x, std::span<double> y) const;
  void FindFactors() const;
  void Factor() const;

  std::vector<ContactRow> rows_;      // with the discs' numbers in the system, -1 if there is none that moves
  std::vector<double> inverse_mass_;  // by these numbers
  bool symmetric_ = true;
  mutable std::shared_ptr<Factors> factors_;  // when first needed
  mutable std::vector<double> dense_;         // likewise
};

}  // namespace saltus
