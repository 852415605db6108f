// Real roots and minima of a polynomial on an interval, to the last digits.
#pragma once

#include <vector>

namespace saltus::exact_internal {

// p(t) = sum_i p[i] t^i
using Polynomial = std::vector<double>;

double Evaluate(const Polynomial& p, double t);
Polynomial Derivative(const Polynomial& p);
Polynomial Multiply(const Polynomial& a, const Polynomial& b);
Polynomial Add(const Polynomial& a, const Polynomial& b);

// Where p changes sign in [low, high], in increasing order, and `low` and `high` if p is zero there. A root of even
// multiplicity inside the interval is not reported. Finds the roots of p' first: between them p is monotone.
std::vector<double> RootsBetween(const Polynomial& p, double low, double high);

double MinimumBetween(const Polynomial& p, double low, double high);

}  // namespace saltus::exact_internal
