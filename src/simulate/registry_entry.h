// The registry's entries. Every model is instantiated in a translation unit of its own, generated from
// registry_entry.cc.in for each line of contact/models.cmake.
#pragma once

#include "saltus/simulate/registry.h"

namespace saltus {

// The entry of line kIndex of contact/models.cmake.
template <int kIndex>
ContactEntry EntryOf();

}  // namespace saltus
