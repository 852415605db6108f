// The registry of contact models: one include and one line each. The order is that of every table and list.
#pragma once

#include <tuple>

#include "saltus/contact/compliant_brax.h"
#include "saltus/contact/compliant_warp.h"
#include "saltus/contact/convex.h"
#include "saltus/contact/direct.h"
#include "saltus/contact/event.h"
#include "saltus/contact/lcp.h"
#include "saltus/contact/pbd_brax.h"
#include "saltus/contact/pbd_warp.h"
#include "saltus/contact/toi_velocity.h"

namespace saltus {

// clang-format off
using ContactModels = std::tuple<
    Lcp,
    Convex<false>,
    Convex<true>,
    Direct<false>,
    Direct<true>,
    CompliantWarp,
    CompliantBrax,
    PbdWarp,
    PbdBrax,
    ToiVelocity,
    Event>;
// clang-format on

}  // namespace saltus
