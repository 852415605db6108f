// Ties of the event-driven model (event.h): impacts at the same time that share discs.
//
// Where one disc strikes two at once, or a row of discs that touch is struck at both ends, Newton's law says what each
// impact does but not which comes first, and another order may lead elsewhere. A tie is a group of contacts that meet
// at the time of one impact and are connected through discs that move. It is ambiguous if its outcome, the velocities
// after all of its impacts, depends on the order in which contacts are preferred; in an order, the impact that comes
// next is that of the first contact that closes. Each order is tried on the values of the discs, and its outcome
// compared.
#pragma once

#include <cmath>
#include <span>

#include "contact/event/event_disc.h"

namespace saltus {

// The orders in which a tie of so many contacts is tried: all of up to five contacts; of more, as many as of five,
// drawn by a generator with a fixed seed.
int NumTieOrders(int num_contacts);

// Rearranges the contacts of a tie, given in the order of the candidates, to order 1..NumTieOrders(contacts.size()).
// Higher numbers start again from the first.
void ArrangeTie(int order, std::span<int> contacts);

namespace internal {

// Two contacts meet at the same time if, at the time of the first, the gap of the other is at most kTieGap of its
// contact distance and it closes it (or has opened it) within kTieTime of the step; or if it touches already.
inline constexpr double kTieGap = 1e-9;
inline constexpr double kTieTime = 1e-6;
// Below it the rounding of positions, relative to them, decides.
inline constexpr double kTieRounding = 1e-13;
// Outcomes are the same if velocities are, relative to the fastest impact; and beyond what the rule for slow contacts
// leaves.
inline constexpr double kTieSpeed = 1e-6;
inline constexpr double kTieSlowSpeed = 10 * kSlowSpeed;
// Impacts of one tie, after which they have no restitution.
inline constexpr int kMostTiedImpacts = 200;

// distance: at which the two touch, size: of the coordinates of the discs, m.
inline bool MeetsNow(const Approach& approach, double distance, double size, double h) {
  if (approach.Touching() || approach.gap <= kTieRounding * size) return true;
  return approach.gap <= kTieGap * distance && approach.gap <= kTieTime * h * std::abs(approach.speed);
}

}  // namespace internal
}  // namespace saltus
