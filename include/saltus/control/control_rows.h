// Conversion of controls between the rows of files and Python, and the layout of the library (Scene::control_width()).
//
// Rows are K x C x 2 numbers [u_x u_y] or, in scenes with torque controls, K x C x 3 numbers [u_x u_y torque], in N and
// N m; the library has torque / radius, in N, behind all forces of an interval. The third number is 0 for discs without
// a torque control.
#pragma once

#include <span>
#include <string>
#include <vector>

#include "saltus/scene/scene.h"

namespace saltus {

// Returns how many numbers a row has for one controlled disc, 2 or 3.
int ControlColumns(const Scene& scene);

// Returns the error in such rows, with the number of the interval and the disc; empty if there is none.
std::string ValidateControlRows(const Scene& scene, std::span<const double> rows);

// Convert a control to rows and back. Preconditions: the scene is valid; there are numbers for a whole number of
// intervals, and ValidateControlRows(scene, rows) is empty.
std::vector<double> RowsOfControl(const Scene& scene, std::span<const double> control);
std::vector<double> ControlOfRows(const Scene& scene, std::span<const double> rows);

// Converts derivatives by a control of the library to derivatives by the numbers of its rows; 0 for those that are no
// variables.
std::vector<double> RowsOfGradient(const Scene& scene, std::span<const double> gradient);

}  // namespace saltus
