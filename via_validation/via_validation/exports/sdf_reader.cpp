// Reads an SDF file with libsdformat; its errors and warnings go to the error output.
#include <iostream>
#include <sdf/sdf.hh>

int main(int, char **words) {
  sdf::Root root;
  const auto errors = root.Load(words[1]);
  for (const auto &each : errors) std::cerr << each.Message() << std::endl;
  return errors.empty() ? 0 : 1;
}
