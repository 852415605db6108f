// The numbers that are identified: how their bounds are kept, and what change of them matters.
#pragma once

#include "saltus/identify/identify.h"

namespace saltus {

// Whether its coordinate is another than its value.
bool HasBounds(const Unknown& unknown);

// Converts a coordinate without bounds to the parameter: logistic for restitution, exponential for positive parameters,
// the identity for the rest.
double FromCoordinate(const Unknown& unknown, double coordinate);
// The bound of an unknown that is nearest to a value.
double BoundNear(const Unknown& unknown, double value);
// Moves a coordinate to the bound nearest to it; one whose bound no motion has stays where it is.
void MoveToBound(const Unknown& unknown, double* coordinate);

// Returns d parameter / d coordinate at a coordinate.
double SlopeAt(const Unknown& unknown, double coordinate);
// The coordinate of a value; of one at a bound, a little inside.
double ToCoordinate(const Unknown& unknown, double value);

// A change of the parameter that matters: what is known no better than this is not known. In the scene's units.
double ScaleOf(const Unknown& unknown, const Scene& scene);

}  // namespace saltus
