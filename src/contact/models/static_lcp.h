// Contact with static friction only: what touches sticks, whatever the coefficient (Du et al. 2021, "DiffPD").
//
//   v_f = v + h (u/m + g),  d* = h v_f;   n_c and t_c at the old positions p
//   d   = argmin 1/2 |d - d*|^2_M + omega/2 sum over A of (t_c . d_rel)^2   s.t.   n_c . d_rel = g_c,  c in A
//   p'  = p + d,  v' = d / h of the discs in A
//
// g_c = -phi_c(p): the gap closes (anchor at the surface); in the source g_c = 0: a disc freezes where its step began
// (source_anchor=1). A is empty at first. In every round contacts of A that pull leave it, by the forces of least norm
// along all n and t that hold d, and pairs that overlap at p + d join it. If that does not end, the step has no result.
//
// Two discs that touch stick to each other; a disc with two contacts at most closes both gaps, and the tangents yield,
// as they are held by omega only. Impacts are plastic.
//
// The derivative is that of the equations of d in A, by the implicit function theorem. It is not that of an impact: the
// place where a disc stops along the surface does not know when the impact was.
#pragma once

#include <Eigen/Core>
#include <limits>
#include <memory_resource>
#include <vector>

#include "base/linear_algebra.h"
#include "contact/models/contact_rows.h"
#include "contact/solvers/block_solve.h"
#include "saltus/contact/contact_model.h"

namespace saltus {

struct StaticLcp : SemiImplicitFlight<0> {
  static constexpr ModelTraits kTraits = {.name = "static_lcp",
                                          .summary = "static contact: no tangential motion at active contacts",
                                          .source = "DiffPD (Du et al. 2021)",
                                          .friction = false,
                                          .double_engine = true,
                                          .chains = true,
                                          .rebound = Rebound::kPlastic,
                                          .projects = true,
                                          .allocates = true,
                                          .relative = true,
                                          .by_pair = true};
  template <typename T>
  using State = BodyState<T, 0>;

  bool source_anchor = false;
  int rounds = 10;
  double omega = 1e8;  // kg
  template <typename Visit>
  void VisitOptions(const Visit& visit) {
    visit(ModelOption{"source_anchor", "1: discs in contact stay where the step began, as in the source", 0, 1},
          source_anchor);
    visit(ModelOption{"rounds", "rounds of the active-set update of contacts", 1, 1e4}, rounds);
    visit(ModelOption{"omega", "penalty weight of tangential motion, kg", 1, 1e12}, omega);
  }

  template <typename T>
  void Step(const StepInput<T>& in, std::span<const State<T>> x, std::span<State<T>> next) const {
    FreeFlight(*this, in, x, next);
    // The first numbers, one for each pair, are not zero for those in A; the unknowns follow.
    const std::span<const double> found = in.Solved([&] { return FindContacts<T>(in, x, next); });
    const Rows<T> rows(in, x, found);
    if (rows.contacts.empty()) return;
    for (const GapContact<T>& contact : rows.contacts) in.Report(contact.candidate, ContactMode::kStick);
    const std::pmr::vector<T> moved = Differentiated<T>(in, rows, next, found.subspan(in.candidates.size()));
    for (std::size_t k = 0; k < rows.discs.size(); ++k) {
      State<T>& to = next[rows.discs[k]];
      const Vec2<T> d(moved[2 * k], moved[2 * k + 1]);
      to.p = x[rows.discs[k]].p + d;
      to.v = Vec2<T>(Divide(d[0], in.h), Divide(d[1], in.h));
    }
  }

 private:
  // The overlap at which a pair joins A, m.
  static constexpr double kJoins = 1e-13;

  // The contacts of A, and the free discs that they hold: unknowns are the displacements of these, then the multipliers
  // of the normals, p, and of the tangents, f = omega t . d_rel.
  template <typename T>
  struct Rows {
    // `in_contact` has one number for each pair, which is not zero for those in A.
    Rows(const StepInput<T>& in, std::span<const State<T>> x, std::span<const double> in_contact)
        : contacts(in.scratch), discs(in.scratch), place(x.size(), -1, in.scratch) {
      for (std::size_t i = 0; i < in.candidates.size(); ++i) {
        if (in_contact[i] == 0) continue;
        const Candidate& c = in.candidates[i];
        const Separation<T> at = SeparationAt(in, c, [&](int disc) -> const Vec2<T>& { return x[disc].p; });
        contacts.push_back({c, at.normal, at.distance - in.ContactDistance(c)});
        for (const int disc : {c.a, c.plane ? c.a : c.b}) {
          if (in.bodies[disc].fixed || place[disc] >= 0) continue;
          place[disc] = static_cast<int>(discs.size());
          discs.push_back(disc);
        }
      }
    }
    std::pmr::vector<GapContact<T>> contacts;
    std::pmr::vector<int> discs;
    std::pmr::vector<int> place;  // of each disc in `discs`; -1 if it is not held, or fixed
    int size() const { return static_cast<int>(2 * (discs.size() + contacts.size())); }
    int NormalRow(std::size_t i) const { return static_cast<int>(2 * discs.size() + i); }
    int TangentRow(std::size_t i) const { return static_cast<int>(2 * discs.size() + contacts.size() + i); }

    // Calls visit(unknown of d_x, sign) for the discs of contact i that move.
    template <typename Visit>
    void ForEachSide(std::size_t i, const Visit& visit) const {
      const Candidate& c = contacts[i].candidate;
      if (place[c.a] >= 0) visit(2 * place[c.a], 1.0);
      if (!c.plane && place[c.b] >= 0) visit(2 * place[c.b], -1.0);
    }
    // Calls visit(disc, sign) for those that are fixed, and may be on a path.
    template <typename Visit>
    void ForEachFixedSide(const StepInput<T>& in, std::size_t i, const Visit& visit) const {
      const Candidate& c = contacts[i].candidate;
      if (in.bodies[c.a].fixed) visit(c.a, 1.0);
      if (!c.plane && in.bodies[c.b].fixed) visit(c.b, -1.0);
    }
  };

  // Returns F(z) of M (d - d*) + T^T f - N^T p = 0, N d = g and T d = f / omega. `flying` has the velocities v_f.
  template <typename T, typename Z>
  std::pmr::vector<T> Residual(const StepInput<T>& in, const Rows<T>& rows, std::span<const State<T>> flying,
                               const Z& z) const {
    std::pmr::vector<T> F(rows.size(), T(0.0), in.scratch);
    for (std::size_t k = 0; k < rows.discs.size(); ++k) {
      const int disc = rows.discs[k];
      for (int j = 0; j < 2; ++j) F[2 * k + j] = in.bodies[disc].mass * (z[2 * k + j] - in.h * flying[disc].v[j]);
    }
    for (std::size_t i = 0; i < rows.contacts.size(); ++i) {
      const GapContact<T>& contact = rows.contacts[i];
      const Vec2<T> tangent = Perpendicular(contact.normal);
      T along = source_anchor ? T(0.0) : contact.gap, slid = T(0.0);
      rows.ForEachSide(i, [&](int at, double sign) {
        along += sign * (contact.normal[0] * z[at] + contact.normal[1] * z[at + 1]);
        slid += sign * (tangent[0] * z[at] + tangent[1] * z[at + 1]);
      });
      rows.ForEachFixedSide(in, i, [&](int disc, double sign) {
        along += sign * in.h * Dot(contact.normal, flying[disc].v);
        slid += sign * in.h * Dot(tangent, flying[disc].v);
      });
      const int normal = rows.NormalRow(i), tangential = rows.TangentRow(i);
      F[normal] = along;
      F[tangential] = slid - z[tangential] / omega;
      rows.ForEachSide(i, [&](int at, double sign) {
        for (int j = 0; j < 2; ++j) F[at + j] += sign * (tangent[j] * z[tangential] - contact.normal[j] * z[normal]);
      });
    }
    return F;
  }

  // Returns dF/dz, as values.
  template <typename T>
  Eigen::MatrixXd Matrix(const StepInput<T>& in, const Rows<T>& rows) const {
    Eigen::MatrixXd K = Eigen::MatrixXd::Zero(rows.size(), rows.size());
    for (std::size_t k = 0; k < rows.discs.size(); ++k) {
      K.block<2, 2>(2 * k, 2 * k).diagonal().setConstant(Value(in.bodies[rows.discs[k]].mass));
    }
    for (std::size_t i = 0; i < rows.contacts.size(); ++i) {
      const Vec2d n(Value(rows.contacts[i].normal[0]), Value(rows.contacts[i].normal[1])), t = Perpendicular(n);
      const int normal = rows.NormalRow(i), tangential = rows.TangentRow(i);
      K(tangential, tangential) = -1 / omega;
      rows.ForEachSide(i, [&](int at, double sign) {
        K.block<1, 2>(normal, at) = sign * n.transpose();
        K.block<2, 1>(at, normal) = -sign * n;
        K.block<1, 2>(tangential, at) = sign * t.transpose();
        K.block<2, 1>(at, tangential) = sign * t;
      });
    }
    return K;
  }

  // Returns displacements and multipliers: the value `z`, which solves the equations, with one Newton correction in T.
  template <typename T>
  std::pmr::vector<T> Differentiated(const StepInput<T>& in, const Rows<T>& rows, std::span<const State<T>> flying,
                                     std::span<const double> z) const {
    std::pmr::vector<T> corrected(z.begin(), z.end(), in.scratch);
    if constexpr (!std::is_same_v<T, double>) {
      const std::pmr::vector<T> residual = Residual<T>(in, rows, flying, corrected);
      Eigen::MatrixXd variation(rows.size(), kJetWidth);
      for (int i = 0; i < rows.size(); ++i) variation.row(i) = residual[i].v;
      const Eigen::MatrixXd change = LeastNormSolutions(Matrix(in, rows), variation);
      for (int i = 0; i < rows.size(); ++i) corrected[i].v = -change.row(i);
    }
    return corrected;
  }

  template <typename T>
  std::vector<double> FindContacts(const StepInput<T>& in, std::span<const State<T>> x,
                                   std::span<const State<T>> flying) const {
    std::vector<double> found(in.candidates.size(), 0.0);
    for (int round = 0; round <= rounds; ++round) {
      const std::vector<double> held = found;
      const Rows<T> rows(in, x, held);
      const Eigen::VectorXd z = Solve(in, rows, flying);
      const Eigen::VectorXd normal = NormalForces(in, rows, flying, z);
      int contact = 0;
      for (std::size_t i = 0; i < held.size(); ++i) {
        if (held[i] != 0) {
          if (normal[contact++] < 0) found[i] = 0;
        } else if (GapAfter(in, rows, in.candidates[i], x, flying, z) < -kJoins) {
          found[i] = 1;
        }
      }
      if (found != held) continue;
      found.insert(found.end(), z.begin(), z.end());
      return found;
    }
    return FailToConverge(in, x, std::move(found));
  }

  template <typename T>
  static std::vector<double> FailToConverge(const StepInput<T>& in, std::span<const State<T>> x,
                                            std::vector<double> found) {
    in.Fail("the set of active contacts does not converge within `rounds`: raise this option");
    if (std::count(found.begin(), found.end(), 0.0) == std::ptrdiff_t(found.size())) found[0] = 1;
    const Rows<T> rows(in, x, found);
    found.resize(found.size() + rows.size(), std::numeric_limits<double>::quiet_NaN());
    return found;
  }

  template <typename T>
  Eigen::VectorXd Solve(const StepInput<T>& in, const Rows<T>& rows, std::span<const State<T>> flying) const {
    if (rows.contacts.empty()) return Eigen::VectorXd(0);
    const std::pmr::vector<T> at_zero = Residual<T>(in, rows, flying, std::vector<double>(rows.size(), 0.0));
    Eigen::VectorXd F(rows.size());
    for (int i = 0; i < rows.size(); ++i) F[i] = Value(at_zero[i]);
    return SolveByBlocks(Matrix(in, rows), -F);
  }

  // Returns the forces of least norm, along the normals and tangents of A, under which the discs move by z.
  template <typename T>
  static Eigen::VectorXd NormalForces(const StepInput<T>& in, const Rows<T>& rows, std::span<const State<T>> flying,
                                      const Eigen::VectorXd& z) {
    const auto num_contacts = static_cast<Eigen::Index>(rows.contacts.size());
    if (num_contacts == 0) return Eigen::VectorXd(0);
    Eigen::MatrixXd directions = Eigen::MatrixXd::Zero(2 * rows.discs.size(), 2 * num_contacts);
    Eigen::VectorXd needed(2 * rows.discs.size());
    for (std::size_t k = 0; k < rows.discs.size(); ++k) {
      const int disc = rows.discs[k];
      for (int j = 0; j < 2; ++j) {
        needed[2 * k + j] = Value(in.bodies[disc].mass) * (z[2 * k + j] - in.h * Value(flying[disc].v[j]));
      }
    }
    for (Eigen::Index i = 0; i < num_contacts; ++i) {
      const Vec2d n(Value(rows.contacts[i].normal[0]), Value(rows.contacts[i].normal[1]));
      rows.ForEachSide(i, [&](int at, double sign) {
        directions.block<2, 1>(at, i) = sign * n;
        directions.block<2, 1>(at, num_contacts + i) = sign * Perpendicular(n);
      });
    }
    return SolveByBlocks(directions, needed).head(num_contacts);
  }

  template <typename T>
  static double GapAfter(const StepInput<T>& in, const Rows<T>& rows, const Candidate& c, std::span<const State<T>> x,
                         std::span<const State<T>> flying, const Eigen::VectorXd& z) {
    const auto position = [&](int disc) -> Vec2d {
      const int place = rows.place[disc];
      if (place < 0) return {Value(flying[disc].p[0]), Value(flying[disc].p[1])};
      return {Value(x[disc].p[0]) + z[2 * place], Value(x[disc].p[1]) + z[2 * place + 1]};
    };
    return GapValue(in, c, position);
  }
};

}  // namespace saltus
