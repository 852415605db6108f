#include "saltus/contact/contact_model.h"

namespace saltus {

const char* ContactModeToString(ContactMode mode) {
  switch (mode) {
    case ContactMode::kSlip:
      return "slip";
    case ContactMode::kStick:
      return "stick";
    case ContactMode::kPocketed:
      return "pocketed";
    case ContactMode::kFrictionless:
      break;
  }
  return "frictionless";
}

}  // namespace saltus
