# The registry of contact models: header and type, one line each. The order is that of every table and list.
set(saltus_models
  "saltus/contact/lcp.h Lcp"
  "saltus/contact/convex.h Convex<false>"
  "saltus/contact/convex.h Convex<true>"
  "saltus/contact/direct.h Direct<false>"
  "saltus/contact/direct.h Direct<true>"
  "saltus/contact/compliant_warp.h CompliantWarp"
  "saltus/contact/compliant_brax.h CompliantBrax"
  "saltus/contact/pbd_warp.h PbdWarp"
  "saltus/contact/pbd_brax.h PbdBrax"
  "saltus/contact/toi_velocity.h ToiVelocity"
  "saltus/contact/event.h EventDriven")
