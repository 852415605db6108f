// Motions of discs that a reader can play in a page.
//
// The data are JSON. Numbers are multiples of a quantum (of positions 1e-7 of the drawing's size, of
// velocities and forces 1e-6 of the largest, of angles 1e-5 rad); each column is written as its second differences,
// which free flight makes 0 or nearly so, in integers of variable length, and these as base64: 1.4 bytes a number where
// discs fly, at most 4 or so where they do not. Times are written in full.
#pragma once

#include <array>
#include <nlohmann/json_fwd.hpp>
#include <string>
#include <vector>

#include "output/figure.h"

namespace saltus {

struct ReplayDisc {
  std::string name;
  double radius = 0;  // m
  bool fixed = false;
  // Bounds of each component of the force on it, N, of the force's length, N, and of the torque, N m; 0 without a
  // bound.
  double max_component = 0, max_force = 0, max_torque = 0;
};

// A wall of discs: a half-plane, whose `normal` (of length 1) points to the side of the discs; a side of a wall with
// ends; a part of a circle, or a point; or the table under the discs.
struct ReplayWall {
  enum class Kind { kHalfPlane, kSide, kCircle, kTable };
  std::string name;
  std::array<double, 2> point = {0, 0};   // m, on the line, or the centre
  std::array<double, 2> normal = {0, 1};  // of a line
  Kind kind = Kind::kHalfPlane;           // half-planes are drawn; outlines show the others
  double radius = 0;                      // m, of a circle
};

// A contact of disc a and disc b, or wall b; with equal times it is an impact.
struct ReplayTouch {
  int a = 0, b = 0;
  bool wall = false;
  double begin = 0, end = 0;               // s
  std::array<double, 2> impulse = {0, 0};  // N s, on disc a, or of the one on disc b the opposite if a is fixed
};

// The covariance of positions about a motion.
struct ReplaySpread {
  std::string label;                // "closed loop"
  std::vector<double> times;        // s, rising
  std::vector<double> covariances;  // times.size() x discs x 3: of x, of x and y, of y, m^2
};

struct ReplayMotion {
  std::string label, remark;  // the remark may be empty
  bool shown = true;          // at first; the reader may change it
  std::string colour = "#000000";
  Dash dash = Dash::kSolid;
  std::vector<double> times;        // s, never falling; at least one
  std::vector<double> states;       // times.size() x discs x 4: p_x p_y v_x v_y
  std::vector<double> angles = {};  // times.size() x discs, rad; empty if no disc turns
  bool arcs = false;                // positions in between are cubics by velocities, not straight lines
  std::vector<ReplayTouch> touches = {};
  std::vector<int> pushed = {};      // discs with a force on them
  std::vector<double> control = {};  // K x pushed x 2, N
  std::vector<double> torques = {};  // K x pushed, N m; empty if no disc is turned
  std::vector<double> ends = {};     // of the K intervals, s
  std::vector<ReplaySpread> spreads = {};
};

struct Replay {
  std::vector<ReplayDisc> discs;
  std::vector<ReplayWall> walls;
  std::vector<Outline> outlines;
  std::vector<std::array<double, 2>> targets;
  std::vector<ReplayMotion> motions;
};

// Converts a replay. Preconditions: at least one disc and one motion, sizes as stated.
nlohmann::ordered_json ReplayToJson(const Replay& replay);

}  // namespace saltus
