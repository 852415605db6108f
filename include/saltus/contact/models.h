// The registry of contact models: one include and one line each. The order is that of every table and list.
#pragma once

#include <tuple>

#include "saltus/contact/direct.h"

namespace saltus {

// clang-format off
using ContactModels = std::tuple<
    Direct<false>,
    Direct<true>>;
// clang-format on

}  // namespace saltus
