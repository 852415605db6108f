#include "control/running_loss.h"

#include <algorithm>

#include "control/phase_costs.h"

namespace saltus {
namespace {

// |q - target|^2 of a disc, s after a piece has begun.
double SquaredDistance(const Flight::Piece& piece, const RunningTerm& term, double s) {
  const Vec2d &p = piece.at_start.p[term.body], &v = piece.at_start.v[term.body], &a = piece.acceleration[term.body];
  const Vec2d q =
      term.quantity == TerminalTerm::Quantity::kPosition ? Vec2d(p + s * (v + 0.5 * s * a)) : Vec2d(v + s * a);
  return (q - TargetAt(term, piece.start + s)).squaredNorm();
}

double Integral(const Flight::Piece& piece, const RunningTerm& term) {
  double sum = 0;
  for (double begin = 0; begin < piece.duration;) {
    const auto turn = std::upper_bound(term.times.begin(), term.times.end(), piece.start + begin);
    double end = piece.duration;
    if (turn != term.times.end()) end = std::min(end, *turn - piece.start);
    if (!(end > begin)) end = piece.duration;  // a turn within rounding of here
    for (size_t i = 0; i < kGaussNodes.size(); ++i) {
      sum += kGaussWeights[i] * (end - begin) * SquaredDistance(piece, term, begin + kGaussNodes[i] * (end - begin));
    }
    begin = end;
  }
  return sum;
}

}  // namespace

double RunningLoss(const Scene& scene, const Flight& flight) {
  double loss = 0;
  for (const RunningTerm& term : scene.objective.running) {
    for (const Flight::Piece& piece : flight.pieces()) loss += term.weight * Integral(piece, term);
  }
  for (const ViaTerm& term : scene.objective.via) {
    if (term.hard) continue;
    const DiscStates x = flight.Before(term.time);
    const Vec2d& q = term.quantity == TerminalTerm::Quantity::kPosition ? x.p[term.body] : x.v[term.body];
    loss += term.weight * (q - term.target).squaredNorm();
  }
  return loss;
}

}  // namespace saltus
