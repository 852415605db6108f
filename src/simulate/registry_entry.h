// The registry's entries. The models of a header are instantiated in a translation unit of their own, generated from
// registry_entry.cc.in for the lines of contact/models.cmake.
#pragma once

#include "saltus/simulate/registry.h"

namespace saltus {

// The entry of line kIndex of contact/models.cmake.
template <int kIndex>
ContactEntry EntryOf();

}  // namespace saltus
