# Writes files into a C++ source as text: cmake -DINPUTS=a;b -DOUTPUT=f.cpp -P embed.cmake
set(types .html text/html .css text/css .js text/javascript .json application/json)
set(texts)
set(rows)
foreach(input IN LISTS INPUTS)
  get_filename_component(name ${input} NAME)
  get_filename_component(extension ${input} LAST_EXT)
  list(FIND types ${extension} at)
  math(EXPR at "${at} + 1")
  list(GET types ${at} type)
  string(MAKE_C_IDENTIFIER ${name} symbol)
  file(READ ${input} bytes HEX)
  string(REGEX REPLACE "([0-9a-f][0-9a-f])" "0x\\1," bytes "${bytes}")
  string(APPEND texts "const unsigned char ${symbol}[] = {${bytes}};\n")
  set(path "/${name}")
  if(name STREQUAL index.html)
    set(path "/")
  endif()
  string(APPEND rows "    {\"${path}\", \"${type}\",\n"
         "     {reinterpret_cast<const char*>(${symbol}), sizeof ${symbol}}},\n")
endforeach()
file(WRITE ${OUTPUT} "#include <iterator>

#include \"service/http/internal/page_files.h\"

namespace penumbra::service {

namespace {

${texts}
}  // namespace

const PageFile kPageFiles[] = {
${rows}};
const std::size_t kPageFileCount = std::size(kPageFiles);

}  // namespace penumbra::service
")
