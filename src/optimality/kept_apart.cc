// Whether pairs that must not touch hold a motion back.
#include <algorithm>
#include <limits>

#include "control/impact.h"
#include "optimality/optimality_conditions.h"

namespace saltus {
namespace {

constexpr double kApart = 1e-6;  // of the contact distance: pairs that must not touch and stay so far apart are free

// The least distance of two discs, or of a disc and a plane, less that at which they touch, in parts of that.
double LeastGap(const Scene& scene, const Flight& flight, const NoContact& pair) {
  constexpr int kSamples = 4;  // of a piece
  const Candidate c{pair.a, pair.b, pair.plane};
  const double contact_distance = MakeImpactConstants(scene, c).contact_distance;
  double least = std::numeric_limits<double>::infinity();
  for (const Flight::Piece& piece : flight.pieces()) {
    for (int i = 0; i <= kSamples; ++i) {
      const double s = piece.duration * i / kSamples;
      const auto at = [&](int body) -> Vec2d {
        return piece.at_start.p[body] + s * (piece.at_start.v[body] + 0.5 * s * piece.acceleration[body]);
      };
      const double distance = pair.plane ? Separate<double>(at(pair.a), MakeHalfPlane(scene.planes[pair.b])).distance
                                         : (at(pair.a) - at(pair.b)).norm();
      least = std::min(least, distance / contact_distance - 1);
    }
  }
  return least;
}

}  // namespace

std::string WhyNotConstrainedConditions(const Scene& scene, const Flight& flight) {
  for (const NoContact& pair : scene.no_contact) {
    if (LeastGap(scene, flight, pair) > kApart) continue;
    return "a pair that must not touch holds the motion back; the conditions are those without";
  }
  return "";
}

}  // namespace saltus
