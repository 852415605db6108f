// A scene and the control of a rollout in the scalar of a simulator.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <span>
#include <vector>

#include "saltus/contact/step_input.h"
#include "saltus/scene/scene.h"
#include "saltus/scene/walls.h"
#include "simulate/wide_loops.h"

namespace saltus {

template <typename S>
struct TypedScene {
  TypedScene(const Scene& scene, double step)
      : h(S(step)),
        gravity(scene.gravity.cast<S>()),
        contact{{S(scene.contact.restitution), S(scene.contact.friction)},
                S(scene.contact.stiffness),
                S(scene.contact.damping)} {
    for (const Body& body : scene.bodies) {
      const S mass = S(body.mass);
      bodies.push_back({mass, body.fixed ? S(0) : S(1) / mass, S(body.radius), body.fixed});
      bodies.back().material = body.material + 1;
      if (body.Spins()) bodies.back().inverse_inertia = S(1) / S(body.MomentOfInertia());
      fixed.push_back(body.fixed);
    }
    for (const PairContact& pair : PairContactsOf(scene)) pairs.push_back({S(pair.restitution), S(pair.friction)});
    has_torques = scene.num_torques() > 0;
    if (scene.table) slowing = S(scene.table->friction * scene.table->gravity);
    for (WallPart& part : WallPartsOf(scene)) {
      const Wall<double>& wall = part.wall;
      planes.push_back(
          {wall.normal.cast<S>(), S(wall.offset), wall.side, wall.material, wall.center.cast<S>(), S(wall.radius)});
      extents.push_back(part.extent);
      if (part.table) table = static_cast<int>(wall_parts.size());
      if (part.pocket && num_pockets++ == 0) first_pocket = static_cast<int>(wall_parts.size());
      wall_parts.push_back(std::move(part));
    }
  }

  int num_bodies() const { return static_cast<int>(bodies.size()); }

  // Returns the part of a step's input that is the same in every step. It refers to this object.
  StepInput<S> Input() const {
    StepInput<S> in{};
    in.h = h;
    in.gravity = gravity;
    in.contact = contact;
    in.pairs = pairs;
    in.bodies = bodies;
    in.planes = planes;
    in.extents = extents;
    in.table = table;
    in.first_pocket = first_pocket;
    in.num_pockets = num_pockets;
    in.slowing = slowing;
    return in;
  }

  S h;              // s
  Vec2<S> gravity;  // m/s^2
  ContactConstants<S> contact;
  std::vector<PairConstants<S>> pairs;  // by MaterialPairIndex(); none without materials
  std::vector<BodyConstants<S>> bodies;
  std::vector<char> fixed;  // of each disc
  std::vector<Wall<S>> planes;
  int table = -1;                    // which of these is the table
  int first_pocket = 0;              // where its pockets begin among them, ...
  int num_pockets = 0;               // ... and how many there are
  S slowing = S(0);                  // m/s^2, of discs that slide on it
  bool has_torques = false;          // there are torques
  std::vector<WallExtent> extents;   // of each of these
  std::vector<WallPart> wall_parts;  // the same, not rounded
};

// The forces and torques of a control, each held over a step.
template <typename S>
class HeldControl {
 public:
  explicit HeldControl(const Scene& scene)
      : bodies_(scene.control.bodies),
        torque_bodies_(scene.control.torque_bodies),
        stride_(scene.control_width()),
        place_(scene.bodies.size(), -1),
        torque_place_(scene.bodies.size(), -1) {
    for (std::size_t c = 0; c < bodies_.size(); ++c) place_[bodies_[c]] = static_cast<int>(c);
    for (std::size_t t = 0; t < torque_bodies_.size(); ++t) {
      torque_place_[torque_bodies_[t]] = static_cast<int>(scene.TorqueIndex(0, static_cast<int>(t)));
    }
    for (const Body& body : scene.bodies) radius_.push_back(S(body.radius));
  }

  // Prepares a rollout, whose forces are copied window by window.
  void Resize(std::size_t size) {
    copy_.resize(size);
    forces_ = copy_.data();
    unit_ = derivative_unit_ = 1;
  }
  // Takes over the forces of steps begin..end-1 from a control of the whole rollout.
  void Copy(int begin, int end, std::span<const double> control) {
    const std::ptrdiff_t first = begin * stride(), last = end * stride();
    std::copy(control.begin() + first, control.begin() + last, copy_.begin() + first);
  }
  // Replaces Resize() and Copy(): refers to a control in units of `unit`, N, which must stay as long as it is used.
  void Refer(std::span<const S> control, double unit) {
    forces_ = control.data();
    num_referred_ = control.size();
    unit_ = derivative_unit_ = unit;
  }
  // Copies a control that was referred to, after which unit() is 1.
  void CopyReferred() {
    if (unit_ == 1) return;
    copy_.resize(num_referred_);
    for (std::size_t i = 0; i < num_referred_; ++i) copy_[i] = S(unit_) * forces_[i];
    forces_ = copy_.data();
    unit_ = 1;
  }
  // The units of the forces of ForceOn(), and of those by which derivatives are taken, N.
  double unit() const { return unit_; }
  double derivative_unit() const { return derivative_unit_; }

  bool Pushes(int body) const { return place_[body] >= 0; }
  // The index of the force on a pushed disc in step k; that of the next step is stride() numbers further.
  std::ptrdiff_t Offset(int body, int k) const { return k * stride() + 2 * place_[body]; }
  std::ptrdiff_t stride() const { return stride_; }
  // Returns a pointer to this force, in units of unit(); null if the disc is not pushed.
  const S* ForceOn(int body, int k) const { return Pushes(body) ? forces_ + Offset(body, k) : nullptr; }

  bool HasTorque(int body) const { return torque_place_[body] >= 0; }
  // The index of torque / radius of a turned disc in step k, a pointer to it, and the torque, N m; null and 0 for other
  // discs.
  std::ptrdiff_t TurnOffset(int body, int k) const { return k * stride() + torque_place_[body]; }
  const S* TorqueOn(int body, int k) const { return HasTorque(body) ? forces_ + TurnOffset(body, k) : nullptr; }
  S Torque(int body, int k) const { return HasTorque(body) ? radius_[body] * forces_[TurnOffset(body, k)] : S(0); }

  // Sets the forces and torques of step k; those on other discs stay.
  void SetForce(int k, std::span<Vec2<S>> force, std::span<S> torque) const {
    for (int body : bodies_) {
      const S* u = ForceOn(body, k);
      force[body] = Vec2<S>(S(unit_) * u[0], S(unit_) * u[1]);
    }
    for (int body : torque_bodies_) torque[body] = Torque(body, k);
  }

  // Adds to `push`, of every disc, the largest of its accelerations by the forces of steps begin..end-1, m/s^2.
  void AddLargestAccelerations(int begin, int end, std::span<const BodyConstants<S>> bodies,
                               std::span<double> push) const {
    for (int body : bodies_) {
      // Several maxima, so that they need not wait for each other, each of every fourth step.
      constexpr int kAtATime = 4;
      S most = 0;
      internal::RunWide([&, this] {
        using Pairs = internal::StepPairs<S>;
        using Pack = typename Pairs::Pack;
        const std::ptrdiff_t stride = stride_;
        const S unit = S(unit_);
        const S* u = ForceOn(body, begin);
        Pack largest = {};
        int left = end - begin;
        for (; left >= kAtATime; left -= kAtATime, u += kAtATime * stride) {
          Pack a, b;
          Pairs::Load(u, stride, &a);
          Pairs::Load(u + 2 * stride, stride, &b);
          a *= unit;
          b *= unit;
          a *= a;
          b *= b;
          const Pack sums = __builtin_shufflevector(a, b, 0, 4, 2, 6) + __builtin_shufflevector(a, b, 1, 5, 3, 7);
          largest = sums > largest ? sums : largest;
        }
        S rest = std::max({largest[0], largest[1], largest[2], largest[3]});
        for (; left > 0; --left, u += stride) {
          const S x = unit * u[0], y = unit * u[1];
          rest = std::max(rest, x * x + y * y);
        }
        most = rest;
      });
      push[body] += std::sqrt(double(most)) * double(bodies[body].inverse_mass);
    }
    for (int body : torque_bodies_) {
      double largest = 0;
      for (int k = begin; k < end; ++k) largest = std::max(largest, std::abs(double(Torque(body, k))));
      push[body] += AccelerationByTorque(bodies[body], largest);
    }
  }

  // Returns a bound on the acceleration that a torque can cause, m/s^2: the angular acceleration times the radius of
  // gyration, which friction may turn into speed.
  static double AccelerationByTorque(const BodyConstants<S>& body, double torque) {
    return torque * std::sqrt(double(body.inverse_inertia) * double(body.inverse_mass));
  }

 private:
  std::vector<int> bodies_, torque_bodies_;  // those that are controlled, and of these those that are turned
  std::ptrdiff_t stride_;
  std::vector<int> place_;         // of each disc among them; -1 if it is not
  std::vector<int> torque_place_;  // of each disc: where in a step torque / radius stands; -1 if it is not turned
  std::vector<S> radius_;          // m, of each disc
  std::vector<S> copy_;
  const S* forces_ = nullptr;
  std::size_t num_referred_ = 0;
  double unit_ = 1, derivative_unit_ = 1;
};

}  // namespace saltus
