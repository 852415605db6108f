#include "audit/attribution/step_map.h"

#include <glog/logging.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "base/linear_algebra.h"
#include "contact/law/impact.h"

namespace saltus {

namespace {

// Returns A of dx' = A dx over `bodies`, rotation included.
Eigen::MatrixXd DenseStateMatrix(const StepLinearization& step, const std::vector<int>& bodies) {
  const int size = step.body_size;
  const int n = static_cast<int>(bodies.size());
  Eigen::MatrixXd A = Eigen::MatrixXd::Zero(n * size, n * size);
  const auto local = [&](int body) {
    const auto at = std::find(bodies.begin(), bodies.end(), body);
    return at == bodies.end() ? -1 : static_cast<int>(at - bodies.begin()) * size;
  };
  for (size_t f = 0; f < step.flying.size(); ++f) {
    const int at = local(step.flying[f]);
    if (at < 0) continue;
    const Eigen::Matrix2d identity = Eigen::Matrix2d::Identity();
    A.block<2, 2>(at, at) = step.free.pp * identity;
    A.block<2, 2>(at, at + 2) = step.free.pv * identity;
    A.block<2, 2>(at + 2, at) = step.free.vp * identity;
    A.block<2, 2>(at + 2, at + 2) = step.free.vv * identity;
    if (size > 4) A.block(at + 4, at + 4, size - 4, size - 4) = step.rotation[f];
  }
  for (const StepLinearization::Island& island : step.islands) {
    for (size_t i = 0; i < island.bodies.size(); ++i) {
      for (size_t j = 0; j < island.bodies.size(); ++j) {
        const int row = local(island.bodies[i]), column = local(island.bodies[j]);
        if (row < 0 || column < 0) continue;
        A.block(row, column, size, size) = island.A.block(i * size, j * size, size, size);
      }
    }
  }
  return A;
}

}  // namespace

int NumbersOfDisc(const Scene& scene) { return scene.Spins() ? 4 + kSpin : 4; }

Eigen::VectorXd StateScales(const Scene& scene, const std::vector<int>& bodies, double time) {
  const int size = NumbersOfDisc(scene);
  Eigen::VectorXd scales(size * bodies.size());
  for (size_t i = 0; i < bodies.size(); ++i) {
    const double radius = scene.bodies[bodies[i]].radius;
    const double of_disc[] = {1, 1, time, time, radius, radius * time};
    for (int j = 0; j < size; ++j) scales[size * i + j] = of_disc[j];
  }
  return scales;
}

StepMap RunSteps(const Simulator& simulator, std::span<const double> begin, const ForceOfStep& force, int steps,
                 const std::vector<int>* bodies) {
  StepMap map;
  std::vector<double> x(begin.begin(), begin.end()), next(x.size()), u(simulator.force_size());
  std::vector<Touch> touches;
  StepLinearization linearization;
  Eigen::MatrixXd A;
  for (int k = 0; k < steps && !(k > 0 && simulator.stopped()); ++k) {
    force(k, u);
    if (bodies != nullptr) {
      simulator.Linearize(x, u, /*with_parameters=*/false, &linearization);
      const Eigen::MatrixXd step = DenseStateMatrix(linearization, *bodies);
      A = k == 0 ? step : Multiply(step, A);
    }
    touches.clear();
    simulator.Step(x, u, next, &touches);
    for (const Touch& touch : touches) map.touches.push_back({k, touch});
    std::swap(x, next);
  }
  map.end = x;
  if (bodies == nullptr) return map;
  const int n = static_cast<int>(bodies->size()), size = simulator.body_size(), kept = NumbersOfDisc(simulator.scene());
  map.A.resize(kept * n, kept * n);
  for (int i = 0; i < n; ++i) {
    for (int j = 0; j < n; ++j) map.A.block(kept * i, kept * j, kept, kept) = A.block(i * size, j * size, kept, kept);
  }
  return map;
}

PulledCostate PullBackCostate(Simulator* simulator, std::span<const double> begin, const std::vector<int>& bodies,
                              const Eigen::VectorXd& lambda) {
  const int size = NumbersOfDisc(simulator->scene()), all = simulator->num_bodies();
  CHECK_EQ(simulator->body_size(), size);
  const auto n = static_cast<Eigen::Index>(bodies.size());
  const bool runs =
      simulator->Rollout(ToInitial(begin, all), InitialControl(simulator->scene(), simulator->num_steps()));
  const auto pull_back = [&](bool by_velocities) -> Eigen::VectorXd {
    Eigen::VectorXd pulled = Eigen::VectorXd::Constant(size * n, std::numeric_limits<double>::quiet_NaN());
    if (!runs) return pulled;
    std::vector<double> cotangent(simulator->state_size()), initial(simulator->state_size());
    for (Eigen::Index i = 0; i < n; ++i) {
      for (int j = 0; j < size; ++j) {
        if (IsRate(j) == by_velocities) cotangent[size * bodies[i] + j] = lambda[size * i + j];
      }
    }
    SensitivityView by;
    by.initial = initial;
    simulator->AdjointInto(cotangent, by);
    const std::vector<double> state = ToState(initial, all);
    for (Eigen::Index i = 0; i < n; ++i) {
      for (int j = 0; j < size; ++j) pulled[size * i + j] = state[size * bodies[i] + j];
    }
    return pulled;
  };
  return {pull_back(false), pull_back(true)};
}

namespace {

// A variation of positions and velocities of the pair.
struct Variation {
  std::array<Vec2d, 2> q{Vec2d::Zero(), Vec2d::Zero()};
  std::array<Vec2d, 2> v{Vec2d::Zero(), Vec2d::Zero()};
  std::array<double, 2> angle{}, w{};
};

// Returns the matrix from normal and sliding velocity to the impulse on a along normal and tangent, N s. The law is
// linear as long as neither velocity changes sign.
Eigen::Matrix2d ImpulseLaw(double speed, double sliding, double mass, double stick_mass, const ImpactTerms& terms) {
  using Friction = ImpactTerms::Friction;
  const double bounce = 1 + terms.restitution, mu = terms.friction;
  const double sign = sliding > 0 ? 1 : sliding < 0 ? -1 : 0;
  const auto in_mode = [&](ContactMode mode, double friction) {
    Eigen::Matrix2d law;
    for (int by = 0; by < 2; ++by) {
      const auto [normal, tangential] =
          ImpulseInMode(mode, by == 0 ? 1.0 : 0.0, by == 1 ? 1.0 : 0.0, sign, mass, stick_mass, bounce, friction);
      law.col(by) << normal, tangential;
    }
    return law;
  };
  switch (terms.law) {
    case Friction::kNone:
      return in_mode(ContactMode::kFrictionless, 0);
    case Friction::kSlip:
      return in_mode(ContactMode::kSlip, mu);
    case Friction::kStick:
      return in_mode(ContactMode::kStick, mu);
    case Friction::kCone:
      break;
  }
  const double heavier = mass / stick_mass;  // along the normal; 1 without spin
  Eigen::Matrix2d law = Eigen::Matrix2d::Identity() * -bounce * mass;
  law(1, 1) /= heavier;
  if (std::abs(sliding) > -mu * heavier * speed) {
    law.row(0) << -1, mu * sign;
    law.row(0) *= bounce * mass / (1 + mu * mu * heavier);
    law.row(1) = -mu * sign * law.row(0);
  }
  return law;
}

// Adds the effect of velocities that are taken from projected positions: the part (1 - e) of the normal velocity, and
// all of the friction, follow the overlap instead of the velocity before. `moment` is m n . dd.
void AddOverlap(const PairImpact& impact, const ImpactTerms& terms, double moment, const Vec2d& relative,
                const Vec2d& d_relative, double mass, Vec2d* d_impulse) {
  const double e = impact.restitution;
  (*d_impulse)[0] = -2 * mass * d_relative[0] - (1 - e) * terms.overlap_rate * moment;
  if (terms.law == ImpactTerms::Friction::kSlip) {
    (*d_impulse)[1] = -std::copysign(terms.friction, relative[1]) * (1 + e) * terms.overlap_rate * moment;
  }
}

Variation VaryThroughImpact(const PairImpact& impact, const ImpactTerms& terms, const Variation& in) {
  const Vec2d n = impact.normal, t = Perpendicular(n);
  const Vec2d w = impact.velocity_a - impact.velocity_b;
  const std::array<double, 2> share = {impact.inverse_mass_a, -impact.inverse_mass_b};
  const std::array<Vec2d, 2> a = {impact.acceleration_a, impact.acceleration_b};
  const auto rims = [&](const std::array<double, 2>& of) {
    return terms.rims ? impact.radius[0] * of[0] + impact.radius[1] * of[1] : 0.0;
  };
  const double mass = 1 / (share[0] - share[1]), sliding = Dot(t, w);
  double stick = share[0] - share[1];
  Vec2d relative(Dot(n, w), sliding);
  if (impact.spins) {
    for (int i = 0; i < 2 && terms.turns; ++i) stick += impact.radius[i] * impact.radius[i] * impact.inverse_inertia[i];
    relative[1] -= rims(impact.spin);
  }
  const Eigen::Matrix2d law = ImpulseLaw(relative[0], relative[1], mass, 1 / stick, terms);
  const Vec2d impulse = law * relative;

  const Vec2d dd = in.q[0] - in.q[1];
  const double dtau = -Dot(n, dd) / relative[0];
  std::array<Vec2d, 2> dv = in.v;
  for (int i = 0; i < 2 && terms.acceleration; ++i) dv[i] += dtau * a[i];
  double turn = 0;
  if (terms.normal != ImpactTerms::Normal::kFrozen) {
    const bool shifted = terms.normal == ImpactTerms::Normal::kTurning;
    turn = Dot(t, Vec2d(dd + (shifted ? dtau : 0.0) * w)) * impact.inverse_distance;
  }
  const Vec2d du = dv[0] - dv[1];
  Vec2d d_relative(Dot(n, du) + sliding * turn, Dot(t, du) - relative[0] * turn);
  if (impact.spins) d_relative[1] -= rims(in.w);
  Vec2d d_impulse = law * d_relative;
  if (terms.overlap_rate > 0) AddOverlap(impact, terms, mass * Dot(n, dd), relative, d_relative, mass, &d_impulse);

  const Vec2d kick = (terms.shift_along_normal_only ? impulse[0] * n : Vec2d(impulse[0] * n + impulse[1] * t));
  const Vec2d d_kick = (d_impulse[0] - impulse[1] * turn) * n + (d_impulse[1] + impulse[0] * turn) * t;
  Variation out;
  for (int i = 0; i < 2; ++i) {
    out.v[i] = dv[i] + share[i] * d_kick;
    if (terms.acceleration) out.v[i] -= dtau * a[i];
    out.q[i] = in.q[i] - terms.position_shift * dtau * share[i] * kick;
    const double arm = terms.turns ? impact.radius[i] * impact.inverse_inertia[i] : 0.0;
    out.w[i] = in.w[i] - arm * d_impulse[1];
    out.angle[i] = in.angle[i];
    if (!terms.shift_along_normal_only) out.angle[i] += terms.position_shift * dtau * arm * impulse[1];
  }
  return out;
}

// A known deviation of a model's linearization from that of the exact impact.
struct Fault {
  const char* words;
  void (*apply)(const PairImpact&, ImpactTerms*);
};

// Alternative faults of one term, of which a model has at most one. The one without words is the exact term.
using Family = std::vector<Fault>;

void ForgetTime(ImpactTerms* terms) {
  terms->acceleration = false;
  terms->normal = ImpactTerms::Normal::kAtFixedTime;
}

ImpactTerms::Friction LawOf(ContactMode mode) {
  using Friction = ImpactTerms::Friction;
  return mode == ContactMode::kSlip    ? Friction::kSlip
         : mode == ContactMode::kStick ? Friction::kStick
                                       : Friction::kNone;
}

Family BounceFaults() {
  return {{nullptr, [](const PairImpact& i, ImpactTerms* t) { t->restitution = i.restitution; }},
          {"restitution squared",
           [](const PairImpact& i, ImpactTerms* t) { t->restitution = i.restitution * i.restitution; }},
          {"restitution ignored", [](const PairImpact&, ImpactTerms* t) { t->restitution = 0; }},
          {"restitution taken as 1", [](const PairImpact&, ImpactTerms* t) { t->restitution = 1; }}};
}

Family FrictionFaults() {
  using Friction = ImpactTerms::Friction;
  return {{nullptr, [](const PairImpact& i, ImpactTerms* t) { t->law = LawOf(i.mode); }},
          {"friction ignored", [](const PairImpact&, ImpactTerms* t) { t->law = Friction::kNone; }},
          {"friction squared",
           [](const PairImpact& i, ImpactTerms* t) {
             t->law = Friction::kSlip;
             t->friction *= i.friction;
           }},
          {"sticks where it should slide", [](const PairImpact&, ImpactTerms* t) { t->law = Friction::kStick; }},
          {"slides where it should stick", [](const PairImpact&, ImpactTerms* t) { t->law = Friction::kSlip; }},
          {"restitution multiplies friction, and sliding the normal impulse",
           [](const PairImpact&, ImpactTerms* t) { t->law = Friction::kCone; }}};
}

Family SpinFaults(const PairImpact& impact) {
  Family faults = {{nullptr, [](const PairImpact&, ImpactTerms*) {}}};
  if (!impact.spins || impact.friction == 0) return faults;
  faults.push_back({"friction does not turn the discs", [](const PairImpact&, ImpactTerms* t) { t->turns = false; }});
  faults.push_back(
      {"friction follows the centres and not the rims", [](const PairImpact&, ImpactTerms* t) { t->rims = false; }});
  faults.push_back(
      {"spin has no part in friction", [](const PairImpact&, ImpactTerms* t) { t->turns = t->rims = false; }});
  return faults;
}

// Returns the faults of the impact time. `friction`: whether there is friction that could be missing.
Family TimeFaults(bool friction) {
  const auto half = [](const PairImpact&, ImpactTerms* t) {
    t->position_shift = (1 + t->restitution / 2) / (1 + t->restitution);
    t->shift_along_normal_only = true;
    ForgetTime(t);
  };
  Family faults = {
      {nullptr, [](const PairImpact&, ImpactTerms*) {}},
      {"acceleration at the impact ignored", [](const PairImpact&, ImpactTerms* t) { t->acceleration = false; }},
      {"time of impact ignored",
       [](const PairImpact&, ImpactTerms* t) {
         t->position_shift = 0;
         ForgetTime(t);
       }},
      {"position before the impact ignored (projection)",
       [](const PairImpact&, ImpactTerms* t) {
         t->position_shift = 1 / (1 + t->restitution);
         ForgetTime(t);
       }},
      {"position before the impact ignored (projection), and overlap / step added to the velocity",
       [](const PairImpact& i, ImpactTerms* t) {
         t->position_shift = 1 / (1 + t->restitution);
         t->overlap_rate = 1 / i.step;
         ForgetTime(t);
       }},
      {"relative position bounces by half the restitution; acceleration at the impact ignored", half}};
  if (!friction) return faults;
  faults.back().words =
      "relative position bounces by half the restitution, without friction; acceleration at the impact ignored";
  faults.push_back(
      {"position bounces without friction; acceleration at the impact ignored", [](const PairImpact&, ImpactTerms* t) {
         t->shift_along_normal_only = true;
         ForgetTime(t);
       }});
  return faults;
}

Family NormalFaults() {
  using Normal = ImpactTerms::Normal;
  return {{nullptr, [](const PairImpact&, ImpactTerms*) {}},
          {"normal taken at a fixed time", [](const PairImpact&, ImpactTerms* t) { t->normal = Normal::kAtFixedTime; }},
          {"normal frozen", [](const PairImpact&, ImpactTerms* t) { t->normal = Normal::kFrozen; }}};
}

// Replaces a variation by that after free flight for a time.
void Fly(double time, Variation* x) {
  for (int i = 0; i < 2; ++i) {
    x->q[i] += time * x->v[i];
    x->angle[i] += time * x->w[i];
  }
}

}  // namespace

double ScaledNorm(const Eigen::MatrixXd& difference, const Eigen::VectorXd& scales) {
  double sum = 0;
  for (int r = 0; r < difference.rows(); ++r) {
    for (int c = 0; c < difference.cols(); ++c) {
      const double scale = scales[r] / scales[c];
      sum += difference(r, c) * scale * difference(r, c) * scale;
    }
  }
  return std::sqrt(sum);
}

ImpactTerms ExactTerms(const PairImpact& impact) {
  ImpactTerms terms;
  terms.restitution = impact.restitution;
  terms.law = LawOf(impact.mode);
  terms.friction = impact.friction;
  return terms;
}

Eigen::MatrixXd LinearizeImpact(const PairImpact& impact, const ImpactTerms& terms) {
  const std::array<bool, 2> moves = {impact.inverse_mass_a > 0, impact.inverse_mass_b > 0};
  const int of_disc = impact.spins ? 6 : 4, size = of_disc * impact.num_moving();
  Eigen::MatrixXd jacobian(size, size);
  int column = 0;
  for (int body = 0; body < 2; ++body) {
    for (int j = 0; j < of_disc && moves[body]; ++j, ++column) {
      Variation x;
      if (j < 4) {
        (j < 2 ? x.q : x.v)[body][j % 2] = 1;
      } else {
        (j == 4 ? x.angle : x.w)[body] = 1;
      }
      Fly(impact.before, &x);
      x = VaryThroughImpact(impact, terms, x);
      Fly(impact.after, &x);
      int row = 0;
      for (int i = 0; i < 2; ++i) {
        if (!moves[i]) continue;
        jacobian.col(column).segment<4>(row) << x.q[i], x.v[i];
        if (impact.spins) jacobian.col(column).segment<2>(row + 4) << x.angle[i], x.w[i];
        row += of_disc;
      }
    }
  }
  return jacobian;
}

std::optional<std::string> RecogniseFault(const PairImpact& impact, const Eigen::MatrixXd& model, double duration) {
  constexpr double kEnough = 0.25;    // of the error may be left unexplained
  constexpr double kPerFault = 0.03;  // a further fault must explain more than this
  std::vector<double> factors;
  for (int i = 0; i < 2; ++i) {
    if ((i == 0 ? impact.inverse_mass_a : impact.inverse_mass_b) == 0) continue;
    factors.insert(factors.end(), {1, 1, duration, duration});
    if (impact.spins) factors.insert(factors.end(), {impact.radius[i], impact.radius[i] * duration});
  }
  const Eigen::VectorXd scales = Eigen::Map<Eigen::VectorXd>(factors.data(), static_cast<Eigen::Index>(factors.size()));
  const double error = ScaledNorm(model - LinearizeImpact(impact, ExactTerms(impact)), scales);
  double best = kEnough + 4 * kPerFault;
  std::optional<std::string> words;
  const Family bounces = BounceFaults(), frictions = FrictionFaults(), times = TimeFaults(impact.friction > 0),
               normals = NormalFaults(), turns = SpinFaults(impact);
  for (const Fault& bounce : bounces) {
    for (const Fault& friction : frictions) {
      for (const Fault& time : times) {
        for (const Fault& normal : normals) {
          for (const Fault& turn : turns) {
            ImpactTerms terms = ExactTerms(impact);
            std::string found;
            int count = 0;
            for (const Fault* fault : {&bounce, &friction, &time, &normal, &turn}) {
              fault->apply(impact, &terms);
              if (fault->words == nullptr) continue;
              found += (count++ > 0 ? "; " : "") + std::string(fault->words);
            }
            const double left = ScaledNorm(model - LinearizeImpact(impact, terms), scales) / error;
            if (count == 0 || left > kEnough || left + kPerFault * count >= best) continue;
            best = left + kPerFault * count;
            words = found;
          }
        }
      }
    }
  }
  return words;
}

}  // namespace saltus
