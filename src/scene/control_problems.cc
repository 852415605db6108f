#include "scene/control_problems.h"

#include <cmath>
#include <string>

#include "base/random.h"

namespace saltus {
namespace {

double Rounded(double x) { return std::round(x * 1e4) / 1e4 + 0.0; }  // no negative zeros
Vec2d Rounded(const Vec2d& x) { return {Rounded(x[0]), Rounded(x[1])}; }

// Draws one problem, which may have discs that overlap. Numbers are drawn in braces, between which the order is fixed,
// never in the arguments of a function or in a sum.
class Draw {
 public:
  Draw(int kind, Random* random) : random_(*random), kind_(kControlKinds[kind]) {
    scene_.duration = Number(0.8, 1.6);
    scene_.steps = 120;
    scene_.contact.restitution = Number(0.4, 1);
    scene_.objective.effort = Effort();
    scene_.optimize = Optimize::kControl;
    aim_ = Direction();
    side_ = {-aim_[1], aim_[0]};
    way_ = Number(0.6, 1.4);
  }

  Scene Make() {
    if (kind_ == "bounce") {
      MakeBounce();
    } else {
      MakePair();
      if (kind_ == "gravity") scene_.gravity = Vector(0.3, 2);
      if (kind_ == "wall" || kind_ == "friction") AddWall();
      if (kind_ == "friction") scene_.contact.friction = Number(0.05, 0.7);
      if (kind_ == "box") EncloseInBox();
      if (kind_ == "chain") AddChain();
      if (kind_ == "two_targets") AddSecondTarget();
      if (kind_ == "two_pushed") AddSecondPushed();
      if (kind_ == "posts") AddPosts();
    }
    GuessForces();
    return scene_;
  }

 private:
  double Number(double low, double high) { return Rounded(random_.Uniform(low, high)); }
  // Returns a number of either sign, whose magnitude is between `low` and `high`.
  double Sideways(double low, double high) {
    const double number = Number(low, high);
    return random_.UniformIndex(2) == 0 ? -number : number;
  }
  // Returns a weight of the effort; each order of magnitude is as likely.
  double Effort() {
    constexpr double kEfforts[] = {0.002, 0.005, 0.01, 0.02, 0.05, 0.1};
    return kEfforts[random_.UniformIndex(6)];
  }
  Vec2d Direction() {
    while (true) {
      const double x = random_.Symmetric(), y = random_.Symmetric();
      const double square = x * x + y * y;
      if (square > 0.01 && square < 1) return Vec2d(x, y) / std::sqrt(square);
    }
  }
  Vec2d Vector(double shortest, double longest) {
    const Vec2d direction = Direction();
    return Rounded(Number(shortest, longest) * direction);
  }
  // Returns the position with coordinates along and across the way of the pushed disc, from its start.
  Vec2d ToSceneFrame(const Vec2d& place) const { return Rounded(place[0] * aim_ + place[1] * side_); }

  void AddDisc(const std::string& name, const Vec2d& position) {
    Body disc{.name = name, .radius = Number(0.08, 0.18), .mass = Number(0.5, 2), .position = position};
    scene_.bodies.push_back(disc);
  }
  void AddPost(const std::string& name, const Vec2d& position) {
    scene_.bodies.push_back({.name = name, .radius = Number(0.05, 0.2), .fixed = true, .position = position});
  }
  void AimAt(int body, const Vec2d& target) { scene_.objective.terminal.push_back({.body = body, .target = target}); }

  void MakePair() {
    scene_.control.bodies = {0};
    AddDisc("striker", {0, 0});
    AddDisc("target", ToSceneFrame({way_, Number(-0.1, 0.1)}));
    AimAt(1, ToSceneFrame({way_ + Number(0.2, 0.9), Number(-0.4, 0.4)}));
    if (random_.UniformIndex(4) == 0) {
      scene_.objective.terminal.push_back(
          {.body = 0, .quantity = TerminalTerm::Quantity::kVelocity, .target = {0, 0}, .weight = Number(0.01, 0.1)});
    }
  }

  void AddWall() {
    const Vec2d out = Rounded(aim_ + Number(-1, 1) * side_);
    scene_.planes = {{"wall", ToSceneFrame({Number(1.2, 1.8) * way_, Number(-0.3, 0.3)}), -out}};
  }

  void EncloseInBox() {
    const double half = Number(0.8, 1.2) * way_ + 0.4;
    const Vec2d middle = ToSceneFrame({0.5 * way_, 0});
    const auto wall = [&](const char* name, double x, double y) {
      scene_.planes.push_back({name, Rounded(middle - half * Vec2d(x, y)), {x, y}});
    };
    wall("left", 1, 0);
    wall("right", -1, 0);
    wall("floor", 0, 1);
    wall("roof", 0, -1);
    for (Body& body : scene_.bodies) body.velocity = Vector(0, 1.2);
  }

  void AddChain() {
    const int links = 1 + random_.UniformIndex(3);
    for (int i = 0; i < links; ++i) {
      AddDisc("link" + std::to_string(i), ToSceneFrame({way_ * (i + 1) / (links + 1), Number(-0.06, 0.06)}));
      scene_.bodies.back().radius = Number(0.05, 0.09);
    }
  }

  void AddSecondTarget() {
    AddDisc("other", ToSceneFrame({way_ * Number(0.5, 1.3), Sideways(0.3, 0.7)}));
    AimAt(2, ToSceneFrame({way_ * Number(0.8, 1.6), Number(-0.9, 0.9)}));
  }

  void AddSecondPushed() {
    AddDisc("helper", ToSceneFrame({way_ * Number(0.5, 1.8), Sideways(0.4, 0.9)}));
    scene_.control.bodies = {0, 2};
  }

  void AddPosts() {
    const int posts = 1 + random_.UniformIndex(3);
    for (int i = 0; i < posts; ++i) {
      AddPost("post" + std::to_string(i), ToSceneFrame({way_ * Number(0.3, 1.6), Sideways(0.15, 0.6)}));
    }
  }

  // Makes a disc above the ground that may bounce, with targets for position and velocity.
  void MakeBounce() {
    scene_.control.bodies = {0};
    scene_.gravity = {0, -Number(0.5, 4)};
    AddDisc("ball", {0, Number(0.3, 1)});
    scene_.bodies[0].velocity = Vector(0, 1);
    scene_.planes = {{"ground", {0, 0}, {0, 1}}};
    AimAt(0, {Number(-1, 1), Number(0.2, 1)});
    scene_.objective.terminal.push_back({.body = 0,
                                         .quantity = TerminalTerm::Quantity::kVelocity,
                                         .target = {Number(-1, 1), Number(-0.5, 2)},
                                         .weight = Number(0.05, 1)});
  }

  // Sets constant forces that carry each pushed disc about to the start of the target disc, or to its own target.
  void GuessForces() {
    for (const int body : scene_.control.bodies) {
      const Body& disc = scene_.bodies[body];
      const double t = Number(0.5, 0.9) * scene_.duration;
      const Vec2d place = kind_ == "bounce" ? scene_.objective.terminal[0].target : scene_.bodies[1].position;
      const Vec2d way = place - disc.position - t * disc.velocity - 0.5 * t * t * scene_.gravity;
      const Vec2d error = way_ * Vector(0, 0.15);
      scene_.control.initial.push_back(Rounded(2 * disc.mass / (t * t) * (way + error)));
    }
  }

  Random& random_;
  std::string_view kind_;
  Scene scene_;
  Vec2d aim_, side_;
  double way_;
};

}  // namespace

Scene ControlProblem(std::uint64_t seed) {
  const int kind = static_cast<int>(seed % kNumControlKinds);
  Random random(seed);
  while (true) {
    Scene scene = Draw(kind, &random).Make();
    scene.name = std::string(kControlKinds[kind]) + "_" + std::to_string(seed);
    if (!Validate(scene)) return scene;
  }
}

}  // namespace saltus
