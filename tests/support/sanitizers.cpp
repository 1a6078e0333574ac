// What the sanitizers' run times need to know about libraries that are not built with them. Linked
// into every program of a sanitizer preset.

extern "C" {

// Window libraries load and unload drivers; what stays loaded can be named in a report.
int dlclose(void*) {
  return 0;
}

// The GL stack and the libraries below it keep some memory for the life of the process, OpenCV what
// its workers last used, OpenXR's loader some of each instance, x265 20 KB of each encoder.
const char* __lsan_default_suppressions() {
  return "leak:swrast_dri.so\nleak:libEGL\nleak:libLLVM\nleak:libgallium\nleak:libembree3.so\n"
         "leak:libtbb.so\nleak:libglapi\nleak:libdrm\nleak:libopencv_core.so\n"
         "leak:libopenxr_loader\nleak:libx265\n";
}

// Their locks are invisible to the thread sanitizer, and so is TBB's hand-over of work
// (core/threads/parallel.cpp). Its search for lock cycles gives up where a library below GL holds
// more than sixty locks at once.
const char* __tsan_default_suppressions() {
  return "called_from_lib:libtbb.so\ncalled_from_lib:libembree3.so\ncalled_from_lib:swrast_dri.so\n"
         "called_from_lib:libEGL_mesa.so\ncalled_from_lib:libopencv_core\n"
         "race:tbb::\nrace:libtbb.so\nrace:libembree3.so\nrace:swrast_dri.so\nrace:libopencv\n"
         "mutex:swrast_dri.so\ndeadlock:swrast_dri.so\nthread:libtbb.so\n";
}
const char* __tsan_default_options() {
  return "ignore_noninstrumented_modules=1:detect_deadlocks=0";
}

const char* __ubsan_default_options() {
  return "print_stacktrace=1";
}
}
