in float along;
out vec2 column;

void main() {
    column = vec2(along, -along);
}
