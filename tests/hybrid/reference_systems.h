// The systems whose exact values are known: those of the problems. SI units unless a comment says otherwise.
#pragma once

#include "problems/hybrid/boost_converter.h"
#include "problems/hybrid/bouncing_ball.h"
#include "problems/hybrid/cart_pole_walls.h"
#include "problems/hybrid/juggled_ball.h"
#include "problems/hybrid/rimless_wheel.h"
#include "problems/hybrid/rocking_block.h"
#include "problems/hybrid/simplest_walker.h"
#include "problems/hybrid/slip_hopper.h"
#include "problems/hybrid/switched_line.h"
#include "problems/hybrid/switched_oscillator.h"
#include "problems/hybrid/thermostat.h"
#include "problems/hybrid/turbo_car.h"
#include "problems/hybrid/two_mass_hopper.h"
