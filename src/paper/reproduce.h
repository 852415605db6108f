// Every table and figure of the paper, next to its published values.
#pragma once

namespace saltus {

// `saltus_reproduce`.
int ReproduceMain(int argc, char** argv);

}  // namespace saltus
