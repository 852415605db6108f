#include "saltus/contact/contact_model.h"

namespace saltus {

const char* ContactModeToString(ContactMode mode) {
  constexpr const char* kNames[] = {"frictionless", "slip", "stick", "pocketed"};
  return kNames[static_cast<int>(mode)];
}

}  // namespace saltus
