// A control as files and Python have it, and as the library has it (Scene::control_width()).
//
// Rows: K x C x 2 numbers [u_x u_y]; or, if the scene turns discs, K x C x 3, [u_x u_y torque], in N and N m. The third
// number is 0 for discs that are not turned.
#pragma once

#include <span>
#include <string>
#include <vector>

#include "saltus/scene/scene.h"

namespace saltus {

// Numbers of a row for one controlled disc, 2 or 3.
int ControlColumns(const Scene& scene);

// Returns the error in such rows, with the number of the interval and the disc; empty if there is none.
std::string WhyNoControl(const Scene& scene, std::span<const double> rows);

// Convert a control to rows and back. Preconditions: the scene is valid, a whole number of intervals.
std::vector<double> RowsOfControl(const Scene& scene, std::span<const double> control);
std::vector<double> ControlOfRows(const Scene& scene, std::span<const double> rows);

// Derivatives by a control: from those by the library's numbers to those by the numbers of the rows, 0 by those that
// are no variables.
std::vector<double> RowsOfGradient(const Scene& scene, std::span<const double> gradient);

}  // namespace saltus
